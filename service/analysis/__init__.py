"""What is worked out on a cost map: whether the battery lasts, speeds, the way home, objectives, uncertainty."""
