"""The compact network: one answer in two ways, symmetric where it must be, and equation 5 until it is trained."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from joulemap.model.energy.architectures.compact.dense import CompactPredictor
from joulemap.model.energy.architectures.compact.ground import Scratch, read_ground, slopes_of_squares
from joulemap.model.energy.architectures.compact.net import CompactNet
from joulemap.model.energy.architectures.compact.net import slopes_of_squares as torch_slopes
from joulemap.model.energy.architectures.compact.raster import Buffers, read_cells
from joulemap.model.energy.architectures.compact.tracks import (
    PIXEL_M,
    REACH_M,
    SQUARE,
    TRACK_SCALES,
    TRACKS,
    track_features,
)
from joulemap.model.energy.architectures.compact.weights import CompactConfig, CompactWeights, heading_basis
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.learned import Facts
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.robot_features import robot_features
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ModelError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.patches import cut_squares

ROBOT = Robot()
DOMAIN = Domain({"mass_kg": (15.0, 120.0)}, (0.05, 1.0), 30.0)


def some_net(seed: int = 0) -> CompactNet:
    torch.manual_seed(seed)
    net = CompactNet()
    for layer in (net.rest, net.spread, net.film, net.gains):
        torch.nn.init.normal_(layer.weight, std=0.1)
    features = robot_features(ROBOT, 0.2)
    net.set_feature_ranges(features - 1.0, features + 1.0)
    return net


def predictor(net: CompactNet | None = None) -> CompactPredictor:
    return CompactPredictor((net or some_net()).weights(), Facts(DOMAIN, SQUARE, "some", {"kind": "compact"}))


def rough(resolution_m: float, *, side_m: float = 14.0, seed: int = 0, height_m: float = 300.0) -> Heightmap:
    cells = round(side_m / resolution_m)
    frame = GridFrame(40.0, 90.0, resolution_m, cells, cells)
    heights = height_m + 0.06 * np.random.default_rng(seed).standard_normal(frame.shape)
    return Heightmap(heights.astype(np.float32), frame)


def one_by_one(model: CompactPredictor, heightmap: Heightmap, frame: GridFrame, headings: np.ndarray) -> np.ndarray:
    x, y = frame.centres()
    places = np.broadcast_arrays(x[None, :, None], y[:, None, None], headings)
    return model.segment_traction(heightmap, ROBOT, *(p.ravel() for p in places)).reshape(places[0].shape)


@pytest.mark.parametrize(
    ("resolution_m", "spacing_m"),
    [(0.05, 1.0), (0.1, 1.0), (0.25, 1.0), (1.0, 1.0), (0.1, 0.5), (0.25, 1 / 3), (0.1, 0.7), (0.25, 2.0)],
)
def test_dense_passes_and_single_squares_agree(resolution_m, spacing_m):
    heightmap = rough(resolution_m)
    frame = heightmap.frame.respaced(spacing_m)
    headings = heading_bins(6)
    model = predictor()
    lattice = model.traction_per_m(heightmap, ROBOT, frame, headings)
    np.testing.assert_allclose(lattice, one_by_one(model, heightmap, frame, headings), rtol=1e-5, atol=2e-4)
    assert np.isfinite(lattice[1:-1, 1:-1]).all()


def test_the_two_ways_agree_on_a_robot_wider_than_the_tracks_reach():
    heightmap, robot, headings = rough(0.2, side_m=6.0), Robot(width_m=2.0), heading_bins(6)
    frame = heightmap.frame.respaced(1.0)
    net = some_net()
    torch.nn.init.normal_(net.tracks.weight, std=0.5)
    model = predictor(net)
    x, y = frame.centres()
    places = np.broadcast_arrays(x[None, :, None], y[:, None, None], headings)
    single = model.segment_traction(heightmap, robot, *places).reshape(places[0].shape)
    np.testing.assert_allclose(model.traction_per_m(heightmap, robot, frame, headings), single, rtol=1e-5, atol=5e-4)


@pytest.mark.parametrize("joined", [True, False])
def test_what_passes_read_is_made_of_the_squares(joined):
    heightmap = rough(0.1, height_m=0.0)
    x, y = heightmap.frame.respaced(1.0).centres()
    buffers = Buffers.of(y.size, x.size, joined=joined)
    heights, slopes = read_cells(heightmap, x, y, buffers, joined=joined)
    planes, slopes_planes = heights.shape[1], slopes.shape[2]
    assert (planes, slopes_planes) == ((8, 8) if joined else (17, 16))
    for i, j in ((0, 0), (3, 5), (y.size - 1, 0)):
        square = cut_squares(heightmap, x[j], y[i], size=SQUARE, pixel_m=PIXEL_M, pad_m=REACH_M)
        expected = torch_slopes(torch.from_numpy(square))[0].numpy()
        raster, above = (0, 8 * i) if joined else (i, 0)
        for col in range(16):
            found = slopes[raster, above : above + 16, col % slopes_planes, :, j + col // slopes_planes]
            np.testing.assert_allclose(found.T, expected[:, :, col], atol=2e-5)
        r, c = 5, 13  # of the square
        middle = heights[planes * i + 8, 8 % planes, j + 8 // planes]
        height = heights[planes * i + r, c % planes, j + c // planes] - middle
        assert height == pytest.approx(float(square[0, r, c]), abs=1e-6)


@pytest.mark.parametrize("far", [0.0, 100.0])
def test_asked_without_torch_it_answers_what_torch_answers(far):
    """For a robot inside the learned ranges, and for one far outside."""
    net, rng = some_net(3), np.random.default_rng(3)
    torch.nn.init.normal_(net.gains.bias, std=0.1)
    squares = rng.normal(0.0, 0.05, (5, SQUARE, SQUARE)).astype(np.float32)
    headings, features = rng.uniform(0.0, 6.0, 5), robot_features(ROBOT, 0.2) + np.float32(far)
    basis = heading_basis(headings, net.config.order)
    tracks = track_features(squares, headings, np.full(5, 0.5))
    with torch.inference_mode():
        robot = net.read_robot(torch.from_numpy(features)[None])
        series = net.read_ground(torch_slopes(torch.from_numpy(squares)), robot)[:, :, 0, 0]
        answers = net.ask(series, torch.from_numpy(basis), torch.from_numpy(tracks), robot)
    weights = net.weights().for_robot(features)
    found = read_ground(slopes_of_squares(squares), weights, Scratch.of(1, 5, weights, joined=False))
    np.testing.assert_allclose(found.T, series.numpy(), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(weights.gains, robot.gains[0].numpy(), rtol=1e-6)
    for ours, its in zip(weights.ask(found, basis, tracks), answers, strict=True):
        np.testing.assert_allclose(ours, its.numpy(), rtol=1e-4, atol=1e-5)


def test_weights_of_another_network_are_refused():
    arrays = dict(some_net().weights().arrays)
    config = CompactConfig()
    with pytest.raises(ModelError, match=r"conv0.weight has the shape \(16, 3, 4, 4\), its layer \(8, 3, 4, 4\)"):
        CompactWeights(arrays, CompactConfig(channels=(8, 32, 64)))
    arrays["conv9.bias"] = arrays.pop("conv0.bias")
    with pytest.raises(ModelError, match=r"missing: conv0.bias, unknown: conv9.bias"):
        CompactWeights(arrays, config)


def test_height_above_the_sea_does_not_matter():
    # heights that float32 holds exactly, so that the shift by 512 m loses nothing
    frame = GridFrame(0.0, 12.0, 0.25, 48, 48)
    heights = np.random.default_rng(1).integers(-64, 64, frame.shape) / 1024.0
    low, high = (Heightmap((heights + shift).astype(np.float32), frame) for shift in (0.0, 512.0))
    model = predictor()
    cells, headings = frame.respaced(1.0), heading_bins(5)
    answers = [model.traction_per_m(h, ROBOT, cells, headings) for h in (low, high)]
    np.testing.assert_array_equal(*answers)


def test_untrained_it_is_equation_5():
    heightmap = rough(0.25)
    frame = heightmap.frame.respaced(1.0)
    headings = heading_bins(16)
    answer = predictor(CompactNet()).traction_per_m(heightmap, ROBOT, frame, headings)
    expected = PhysicsPredictor().traction_per_m(heightmap, ROBOT, frame, headings)
    np.testing.assert_allclose(answer, expected, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize(("spacing_m", "efficiency"), [(1.0, 0.0), (0.5, 0.4), (0.7, 0.0)])
def test_the_standard_deviation_too_is_one_answer_in_two_ways(spacing_m, efficiency):
    heightmap, robot = rough(0.1), replace(ROBOT, drivetrain_efficiency=efficiency)
    frame = heightmap.frame.respaced(spacing_m)
    headings = heading_bins(6)
    model = CompactPredictor(some_net(2).weights(), Facts(DOMAIN, SQUARE, "some", spread=Spread(factor=1.7)))
    x, y = frame.centres()
    places = np.broadcast_arrays(x[None, :, None], y[:, None, None], headings)
    std = model.traction_and_std(heightmap, robot, frame, headings)[1]
    single = model.segment_traction_and_std(heightmap, robot, *places)[1].reshape(std.shape)
    assert (std[1:-1, 1:-1] > 0.0).all()
    np.testing.assert_allclose(std, single, rtol=2e-4)
    plain = CompactPredictor(some_net(2).weights(), Facts(DOMAIN, SQUARE, "some")).traction_and_std(
        heightmap, robot, frame, headings
    )
    np.testing.assert_allclose(std, 1.7 * plain[1], rtol=1e-5)


def test_the_answer_does_not_depend_on_how_the_passes_are_cut(monkeypatch):
    heightmap = rough(0.2)
    frame = heightmap.frame.respaced(1.0)
    whole = predictor().traction_and_std(heightmap, ROBOT, frame, heading_bins(16))
    monkeypatch.setattr("joulemap.model.energy.architectures.compact.dense._JOINED_TILE", (5, 9))
    for cut, uncut in zip(predictor().traction_and_std(heightmap, ROBOT, frame, heading_bins(16)), whole, strict=True):
        np.testing.assert_allclose(cut, uncut, rtol=2e-5, atol=1e-4)


def test_the_world_turned_by_a_quarter_turns_the_wheel_tracks():
    squares = np.random.default_rng(0).normal(0.0, 0.03, (6, SQUARE, SQUARE)).astype(np.float32)
    heading, width = np.linspace(0.1, 6.0, 6), np.linspace(0.35, 1.2, 6)
    turned = np.ascontiguousarray(np.rot90(squares, -1, (1, 2)))
    np.testing.assert_allclose(
        track_features(turned, heading + math.pi / 2, width), track_features(squares, heading, width), atol=1e-5
    )


def tracks(square: np.ndarray, heading_rad: float, width_m: float) -> dict[str, float]:
    found = track_features(square[None].astype(np.float32), np.array([heading_rad]), np.array([width_m]))[0]
    return dict(zip(TRACKS, found * TRACK_SCALES, strict=True))


def test_wheel_tracks_of_a_plane_and_of_a_step():
    x, y = np.meshgrid((np.arange(SQUARE) - 8) * PIXEL_M, (8 - np.arange(SQUARE)) * PIXEL_M)
    east = tracks(0.3 * x - 0.2 * y, math.pi / 2, 0.6)
    assert east["grade"] == pytest.approx(0.3, abs=1e-6)
    assert east["cross_grade"] == pytest.approx(0.2, abs=1e-6)
    assert east["rise"] == pytest.approx(2 * 0.3 * 1.5, abs=1e-6)  # two tracks of a metre and a half
    for bent in (
        "second_difference_125",
        "second_difference_250",
        "second_difference_375",
        "curvature",
        "roughness",
        "twist",
    ):
        assert east[bent] == pytest.approx(0.0, abs=1e-6)
    step = np.where(y > 0.06, 0.1, 0.0)  # ten centimetres up just north of the middle, met by both wheels
    north, south = tracks(step, 0.0, 0.5), tracks(step, math.pi, 0.5)
    assert north["rise"] == pytest.approx(0.2, abs=1e-6)
    assert south["rise"] == pytest.approx(0.0, abs=1e-6)
    assert north["second_difference_125"] == pytest.approx(0.4, abs=1e-6)  # each track bends up and back


def test_unknown_within_reach_is_unknown_and_no_further():
    clean = rough(0.25)
    heights = clean.heights.copy()
    heights[25, 29] = math.nan  # x = 47.375, y = 83.625
    holed = Heightmap(heights, clean.frame)
    cells = clean.frame.respaced(1.0)
    model = predictor()
    before = model.traction_per_m(clean, ROBOT, cells, heading_bins(4))
    after = model.traction_per_m(holed, ROBOT, cells, heading_bins(4))
    unknown = np.isnan(after)
    assert (unknown.all(axis=2) == unknown.any(axis=2)).all()
    x, y = cells.centres()
    near = (np.abs(y - 83.625) < REACH_M + 0.25)[:, None] & (np.abs(x - 47.375) < REACH_M + 0.25)[None, :]
    assert (unknown[..., 0] == near).all()
    np.testing.assert_allclose(after[~near], before[~near], rtol=1e-5, atol=1e-4)


def test_a_robot_beyond_the_learned_ranges_is_told_and_answered_like_the_nearest():
    model = predictor()
    heightmap = rough(0.2)
    heavy = Robot(mass_kg=300.0)
    assert model.warnings(heightmap, heavy) == ["mass_kg = 300 is outside the 15..120 the network learned"]
    assert model.warnings(heightmap, Robot()) == []
    low, high = (model.weights.arrays[name] for name in ("feature_low", "feature_high"))
    far = model.weights.for_robot(robot_features(ROBOT, 0.2) + np.float32(100.0)).gains
    assert far == model.weights.for_robot(high).gains
    assert far != model.weights.for_robot(low).gains
