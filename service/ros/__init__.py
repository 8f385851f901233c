"""A node for ROS 2: routes of least energy for Nav2, costs as a grid, and the forecast of the drive."""
