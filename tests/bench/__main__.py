"""`make bench`: seconds per stage on 200 x 200 and 1000 x 1000 cells, each beside its peer in the same run.

Times are the least of several repeats after a warm-up, kernels compiled. SciPy gets the very same move prices.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import platform
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from joulemap.service.library.heightmaps import read_heightmap
from tests.bench.large_maps import bench_large, bench_start_up
from tests.bench.lattice import bench_bins, bench_lattice, bench_tiles
from tests.bench.objectives import compare_objectives
from tests.bench.quality import compare_options, compare_peers, compare_planners
from tests.bench.reach import compare_reach
from tests.bench.searches import bench_searches
from tests.bench.stages import bench
from tests.bench.timing import Row

SIZES = (200, 1000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--resolution", type=float, default=0.25, help="metres per pixel of the heightmaps")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), help="cells along a side, 1 m each")
    parser.add_argument("--json", type=Path, help="also write the rows here")
    only = parser.add_mutually_exclusive_group()
    only.add_argument("--searches", action="store_true", help="only the searches")
    only.add_argument("--lattice", action="store_true", help="only the cost lattice")
    only.add_argument("--large", type=int, nargs="+", help="only start-up, and paths on maps of so many cells a side")
    only.add_argument("--peers", action="store_true", help="set other people's searches beside ours instead")
    only.add_argument("--heightmap", type=Path, help="compare the planners' energies on this map instead")
    only.add_argument("--quality", action="store_true", help="set the default answer beside every other option of ours")
    only.add_argument("--reach", action="store_true", help="set reach beside planning to one goal after another")
    only.add_argument("--objectives", action="store_true", help="set routes that weigh odds beside the cheapest ones")
    parser.add_argument("--tasks", type=int, default=10, help="random tasks a map (--quality, --reach, ...)")
    parser.add_argument("--seed", type=int, default=11, help="of the random tasks of --quality")
    parser.add_argument("--map", default="", metavar="NAME", help="only maps that have this in their name: --quality")
    parser.add_argument("--sampling", type=float, default=0.0, help="seconds of BIT* with --quality; 10 for the whole")
    parser.add_argument("--real", type=Path, help="a heightmap for --quality, --reach and --objectives")
    options = parser.parse_args()
    console = Console(width=140)
    if options.heightmap:
        console.print(compare_planners(read_heightmap(options.heightmap)))
    elif options.quality:
        real = read_heightmap(options.real) if options.real else None
        console.print(compare_options(real, options.tasks, options.sampling, options.seed, options.map))
    elif options.reach:
        for found in compare_reach(read_heightmap(options.real) if options.real else None, options.tasks):
            console.print(found)
    elif options.objectives:
        for found in compare_objectives(read_heightmap(options.real) if options.real else None, options.tasks):
            console.print(found)
    elif options.peers:
        for cells in options.sizes:
            console.print(compare_peers(cells, options.resolution))
    else:
        stages = [bench_lattice, bench]
        if options.searches or options.lattice:
            stages = [bench_searches if options.searches else bench_lattice]
        if options.large:
            rows = [*bench_start_up(), *(row for cells in options.large for row in bench_large(cells))]
        else:
            rows = [row for cells in options.sizes for stage in stages for row in stage(cells, options.resolution)]
            if bench_lattice in stages:
                rows += [*bench_bins(options.resolution), *bench_tiles()]
        machine = (
            f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
        )
        heading = f"joulemap bench, {dt.date.today()}, {machine}, heightmap {options.resolution:g} m per pixel"
        console.print(drawn(rows, heading))
        if options.json:
            options.json.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))


def drawn(rows: list[Row], title: str) -> Table:
    """The rows as a table."""
    table = Table(title=title)
    for name in ("cells", "stage", "seconds", "beside", "ours / theirs"):
        table.add_column(name, justify="right" if name in ("seconds", "ours / theirs") else "left")
    for size, stage, took, peer, ratio in rows:
        table.add_row(
            size, stage, "" if np.isnan(took) else f"{took:.4f}", peer, "" if ratio is None else f"{ratio:.3g}"
        )
    return table


if __name__ == "__main__":
    main()
