"""Heightmaps: reading them, cutting patches from them, making them."""
