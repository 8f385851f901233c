"""Heightmaps: reading them, cutting patches from them, making them."""

import warnings

# Of rasterio, which `formats.raster_checks` asks. For all threads: `catch_warnings` would take theirs too.
warnings.filterwarnings("ignore", "Dataset has no geotransform")
