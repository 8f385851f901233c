"""Whatever bytes arrive: a heightmap or an error in words, and what was written comes back."""

import io

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from joulemap.model.errors import HeightmapError, TooLargeError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.library.heightmaps import read_heightmap

FRAME = GridFrame(500_000.0, 4_000_000.0, 0.5, 12, 9, "EPSG:32630")
MAP = Heightmap(np.random.default_rng(0).normal(50.0, 3.0, FRAME.shape), FRAME)


def _files() -> list[bytes]:
    geotiff = write_geotiff(None, MAP)
    assert geotiff is not None
    npy, npz = io.BytesIO(), io.BytesIO()
    np.save(npy, MAP.heights)
    np.savez_compressed(npz, heights=MAP.heights, resolution_m=0.5)
    rows = "\n".join(" ".join(map(str, row)) for row in MAP.heights)
    asc = f"ncols 9\nnrows 12\nxllcorner 0\nyllcorner 0\ncellsize 0.5\n{rows}\n"
    return [geotiff, npy.getvalue(), npz.getvalue(), asc.encode()]


FILES = _files()
changes = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=6)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(range(len(FILES))), changes, st.booleans(), st.floats(0.0, 1.0))
def test_damaged_files_are_read_or_refused_in_words(
    which: int, changed: list[tuple[float, int]], in_head: bool, kept: float
) -> None:
    data = bytearray(FILES[which])
    reach = min(len(data), 400) if in_head else len(data)
    for place, value in changed:
        data[int(place * reach)] = value
    if kept < 0.3:
        data = data[: int(len(data) * kept / 0.3)]
    try:
        heightmap = read_heightmap(bytes(data), resolution_m=0.5, max_cells=10_000)
    except (HeightmapError, TooLargeError):
        return
    assert not np.isinf(heightmap.heights).any()


@settings(max_examples=25, deadline=None)
@given(
    hnp.arrays(np.float32, (5, 4), elements=st.one_of(st.just(np.nan), st.floats(-400, 8000, width=32))),
    st.floats(0.01, 50.0),
    st.floats(-1e6, 1e6),
    st.floats(-1e7, 1e7),
)
def test_written_heightmaps_come_back(heights: np.ndarray, resolution_m: float, west_m: float, north_m: float) -> None:
    heights[0, 0] = 1.0
    heightmap = Heightmap(heights, GridFrame(west_m, north_m, resolution_m, 5, 4, "EPSG:32630"))
    written = write_geotiff(None, heightmap)
    assert written is not None
    again = read_heightmap(written)
    np.testing.assert_array_equal(again.heights, heightmap.heights)
    assert again.frame == heightmap.frame
