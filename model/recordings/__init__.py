"""Recordings of messages (ROS bags, MCAP): their topics, and the messages of those that are wanted."""
