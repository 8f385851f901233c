"""What the workers do: the tiles of a cost map, and a calibration."""
