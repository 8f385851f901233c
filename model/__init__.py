"""What does it cost to drive there?"""
