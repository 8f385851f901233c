"""Places and areas as users give them, in the coordinates of a map."""
