"""Learning while driving: the filter against its batch fit, and a drive through the Python package."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import InputError
from joulemap.model.loop.calibration_file import read_calibrated, save_calibrated
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.drive_alarms import Cusum, threshold_of
from joulemap.model.loop.drive_filter import Ahead, DriveFilter, DrivePrior, limited
from joulemap.model.loop.drive_prior import change_std, fit_drive_prior

PRIOR = DrivePrior((0.2, 0.3, 0.1, 0.4), passing=0.1, passing_m=7.0, noise=1.3)


def rows(n: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of causes, standard deviations, and energies with errors of less than the limit of outliers."""
    rng = np.random.default_rng(3)
    columns = np.abs(rng.normal([50.0, 25.0, 10.0, 20.0], 5.0, (n, 4)))
    std = rng.uniform(4.0, 9.0, n)
    return columns, std, columns[:, 0] + columns @ [0.1, 0.2, -0.1, 0.3] + 0.5 * std * rng.standard_normal(n)


def covariance_of(columns: np.ndarray, std: np.ndarray, prior: DrivePrior) -> np.ndarray:
    """Of all metres, written out: random slopes, a level that passes, independent errors."""
    apart = np.abs(np.subtract.outer(np.arange(len(std)), np.arange(len(std))))
    level = np.outer(columns[:, 0], columns[:, 0]) * prior.passing**2 * np.exp(-apart / prior.passing_m)
    return (columns * np.square(prior.causes)) @ columns.T + level + np.diag((prior.noise * std) ** 2)


def test_after_all_rows_the_filter_knows_what_the_batch_fit_with_the_same_prior_does() -> None:
    columns, std, measured = rows()
    known = DriveFilter(PRIOR)
    steps = known.learn(columns, measured, std)
    assert np.abs(steps).max() < 3.0  # no metre counts less, so that least squares is the same estimate
    gain = np.square(PRIOR.causes)[:, None] * columns.T @ np.linalg.inv(covariance_of(columns, std, PRIOR))
    assert known.mean[:4] == pytest.approx(gain @ (measured - columns[:, 0]), rel=1e-9)
    expected = np.diag(np.square(PRIOR.causes)) - gain @ columns * np.square(PRIOR.causes)
    assert known.covariance[:4, :4] == pytest.approx(expected, rel=1e-7, abs=1e-12)


def test_of_runs_that_a_threshold_was_not_made_on_no_more_raise_an_alarm_than_stated() -> None:
    """Innovations that are correlated, as real ones: the share holds in the mean over sets of 20 runs."""
    rng = np.random.default_rng(5)

    def _run() -> np.ndarray:
        steps = rng.standard_normal(40)
        for k in range(1, 40):
            steps[k] += 0.4 * steps[k - 1]
        return steps

    def _alarm(steps: np.ndarray, std: float) -> bool:
        sums, threshold = Cusum(), threshold_of(float(len(steps)))
        return any(sums.add(step, 0.0, threshold) for step in limited(steps) / std)

    raised = [
        [_alarm(_run(), std) for _ in range(10)] for std in (change_std(_run() for _ in range(20)) for _ in range(60))
    ]
    assert 0.01 < np.mean(raised) < 0.065, np.mean(raised)  # 5 %, and two standard errors of 60 means of about 5 %


def test_the_energy_of_the_rest_is_that_of_the_joint_distribution_of_all_metres() -> None:
    columns, std, measured = rows()
    known, driven = DriveFilter(PRIOR), 25
    known.learn(columns[:driven], measured[:driven], std[:driven])
    mean, scale = Ahead.of(PRIOR, columns, std).energy(float(driven), known)
    joint, ones = covariance_of(columns, std, PRIOR), np.ones(len(std) - driven)
    given = np.linalg.solve(joint[:driven, :driven], joint[:driven, driven:] @ ones)
    away = (measured - columns[:, 0])[:driven]
    assert mean == pytest.approx(columns[driven:, 0].sum() + given @ away, rel=1e-9)
    variance = ones @ joint[driven:, driven:] @ ones - given @ joint[:driven, driven:] @ ones
    assert scale == pytest.approx(np.sqrt(variance), rel=1e-9)


def test_unchanged_drives_raise_as_many_alarms_as_stated_and_a_change_is_found() -> None:
    rng, metres = np.random.default_rng(5), 400
    threshold, alarms, late = threshold_of(metres), 0, []
    for _ in range(400):
        sums = Cusum()
        alarms += any(
            sums.add(step, float(k), threshold) for k, step in enumerate(limited(rng.standard_normal(metres)))
        )
        changed, k = Cusum(), 0
        while changed.add(limited(1.5 + rng.standard_normal(1))[0], float(k), threshold) is None:
            k += 1
        late.append(k)
    assert 0.01 < alarms / 400 < 0.09  # 5 % are stated
    assert np.median(late) < 20


def flat() -> jm.CostMap:
    """Level ground of 120 x 40 m for a model of rolling alone."""
    return jm.costmap(jm.heightmap(np.zeros((40, 120)), resolution_m=1.0), model="physics")


def driven(drive: jm.Drive, factor: float, *, until_m: float = 60.0, step_s: float = 0.5) -> list[tuple]:
    """Samples of a drive from x = 10 m at 0.5 m/s whose motion takes a factor of the plan."""
    robot = drive.lattice.robot
    power = robot.idle_power_w + factor * (drive.route.energy_j / drive.route.duration_s - robot.idle_power_w)
    times = np.arange(0.0, until_m / 0.5, step_s)
    return [(float(t), (10.0 + 0.5 * t, 20.0), power) for t in times]


def test_a_drive_that_takes_more_is_known_and_said() -> None:
    costs = flat()
    drive = costs.drive([(10.0, 20.0), (110.0, 20.0)])
    before = drive.forecast()
    assert before.energy_j == pytest.approx(drive.route.energy_j)
    assert before.energy_p05_j < before.planned_j < before.energy_p95_j
    for time_s, position, power in driven(drive, 1.4):
        drive.update(time_s, position, power_w=power)
    now, true = drive.forecast(), power / 0.5
    assert now.at_m == pytest.approx(59.75)
    assert now.used_j == pytest.approx(power * 119.5)
    assert now.energy_j == pytest.approx(true * now.left_m, rel=0.03)
    assert now.energy_p95_j - now.energy_p05_j < before.energy_p95_j - before.energy_p05_j
    assert "more than planned" in now.text
    assert now.more.low > 0.0
    assert now.charge == pytest.approx(1.0 - now.used_j / (3600.0 * costs.robot.battery_wh))


def test_the_charge_along_a_drive_joins_what_was_measured_and_what_is_forecast() -> None:
    drive = flat().drive([(10.0, 20.0), (110.0, 20.0)], battery=jm.Battery(20.0, charge=0.9))
    assert [place.charge for place in drive.charge_along()] == pytest.approx(
        [place.planned for place in drive.charge_along()]
    )
    for time_s, position, power in driven(drive, 1.4):
        drive.update(time_s, position, power_w=power)
    now, places = drive.forecast(), drive.charge_along()
    behind, ahead = ([p for p in places if (p.distance_m > now.at_m) == side] for side in (False, True))
    assert behind[-1].charge == pytest.approx(now.charge)
    assert all(p.low == p.high == p.charge < p.planned for p in behind[1:])
    assert [p.charge for p in behind] == pytest.approx(
        np.interp([p.distance_m for p in behind], [0, now.at_m], [0.9, now.charge]), abs=1e-3
    )
    widths = [p.high - p.low for p in ahead]
    assert widths == sorted(widths)
    end, full = places[-1], drive.battery.full_j
    assert (end.distance_m, end.x, end.y) == pytest.approx((100.0, 110.0, 20.0))
    assert now.charge - end.charge == pytest.approx(now.energy_j / full, rel=1e-3)
    assert now.charge - end.low == pytest.approx(now.energy_p95_j / full, rel=5e-3)
    assert len(places) <= 202


def test_a_route_over_the_updated_map_costs_what_is_forecast() -> None:
    drive = flat().drive([(10.0, 20.0), (110.0, 20.0)])
    for time_s, position, power in driven(drive, 1.3):
        drive.update(time_s, position, power_w=power)
    again = drive.costmap().plan((70.0, 20.0), (110.0, 20.0))
    assert again.energy_j / 40.0 == pytest.approx(drive.forecast().energy_j / drive.forecast().left_m, rel=0.02)
    assert drive.better_route() is None  # all of the ground is as dear


def test_late_and_repeated_samples_change_nothing() -> None:
    in_order, mixed = (flat().drive([(10.0, 20.0), (110.0, 20.0)]) for _ in range(2))
    samples = driven(in_order, 1.3)
    for time_s, position, power in samples:
        in_order.update(time_s, position, power_w=power)
    rng = np.random.default_rng(1)
    order = sorted(range(len(samples)), key=lambda k: samples[k][0] + rng.uniform(0.0, 3.0))
    for k in [*order, *order[-5:], 0]:
        mixed.update(samples[k][0], samples[k][1], power_w=samples[k][2])
    assert mixed.forecast() == in_order.forecast()
    assert mixed.tracking.unused == 6


def test_another_process_goes_on_where_the_first_one_was() -> None:
    first, second = (flat().drive([(10.0, 20.0), (110.0, 20.0)]) for _ in range(2))
    samples = driven(first, 1.3)
    for time_s, position, power in samples[:60]:
        first.update(time_s, position, power_w=power)
    second.restore(json.loads(json.dumps(first.as_dict(), allow_nan=False)))
    for time_s, position, power in samples[60:]:
        first.update(time_s, position, power_w=power)
        second.update(time_s, position, power_w=power)
    assert second.forecast() == first.forecast()


def test_a_lost_payload_raises_an_alarm_within_metres() -> None:
    drive = flat().drive([(10.0, 20.0), (110.0, 20.0)])
    for k, (time_s, position, power) in enumerate(driven(drive, 1.0, until_m=90.0)):
        drive.update(time_s, position, power_w=power * (0.6 if k > 160 else 1.0))
    (alarm,) = drive.forecast().alarms
    assert alarm.side == "less"
    assert 40.0 < alarm.at_m < 60.0


def test_beside_the_route_nothing_is_learnt() -> None:
    drive = flat().drive([(10.0, 20.0), (110.0, 20.0)])
    for time_s, (x, y), power in driven(drive, 3.0):
        drive.update(time_s, (x, y + 8.0), power_w=power)
    assert drive.forecast().learnt_m == 0.0
    assert "beside its route" in drive.forecast().text


def test_the_prior_of_runs_that_differ_much_is_wider_than_thought_and_travels_with_the_model(tmp_path: Path) -> None:
    rng, runs, metres = np.random.default_rng(2), 30, 80
    run = np.repeat(np.arange(runs), metres)
    columns = np.abs(rng.normal([50.0, 25.0, 10.0, 20.0], 5.0, (run.size, 4)))
    std = np.full(run.size, 8.0)
    measured = columns[:, 0] * (1.0 + 0.4 * rng.standard_normal(runs)[run]) + std * rng.standard_normal(run.size)
    start = DrivePrior((0.03, 0.03, 0.03, 0.03), passing=0.03, freedom=6.0)
    found = fit_drive_prior(measured, columns, std, run, start)
    assert found.causes[0] > 2.0 * start.causes[0]
    inside = []
    for one in range(runs):
        mine, known = run == one, DriveFilter(found)
        known.learn(columns[mine][:20], measured[mine][:20], std[mine][:20])
        mean, scale = Ahead.of(found, columns[mine], std[mine]).energy(20.0, known)
        inside.append(abs(measured[mine][20:].sum() - mean) < 1.943 * scale)  # 90 % of Student's t of 6
    assert 0.8 <= np.mean(inside) <= 1.0
    save_calibrated(tmp_path, Correction((), (), drive_prior=found.as_dict()), {"name": "physics", "version": "1"})
    kept = read_calibrated(tmp_path)[0].drive_prior
    assert kept is not None
    assert DrivePrior.from_dict(kept) == found
    costs = flat()
    costs.lattice.provenance["model"]["drive_prior"] = kept
    assert costs.drive([(10.0, 20.0), (110.0, 20.0)]).tracking.prior == found


def test_an_old_sample_and_one_after_a_jump_of_the_clock_are_not_taken() -> None:
    drive = flat().drive([(10.0, 20.0), (110.0, 20.0)])
    drive.update(0.0, (10.0, 20.0), power_w=60.0)
    drive.update(1.0, (10.5, 20.0), power_w=60.0)
    drive.update(-9000.0, (10.0, 20.0), power_w=60.0)
    assert (drive.tracking.unused, drive.forecast().used_j) == (1, 60.0)
    with pytest.raises(InputError, match="at most 3600 s"):
        drive.update(1e11, (10.0, 20.0), power_w=60.0)
    drive.update(2.0, (11.0, 20.0), power_w=60.0)
    assert drive.forecast().used_j == pytest.approx(120.0)


@pytest.mark.parametrize("wild", [1e9, -1e9])
def test_a_first_sample_of_a_wrong_clock_is_forgotten(wild: float) -> None:
    drive = flat().drive([(10.0, 20.0), (110.0, 20.0)])
    drive.update(wild, (10.0, 20.0), power_w=60.0)
    with pytest.raises(InputError, match="finite"):
        drive.update(0.0, (10.0, 20.0), power_w=float("nan"))
    for k in range(10):
        drive.update(float(k), (10.0 + 0.5 * k, 20.0), power_w=60.0)
    assert drive.tracking.unused == 1
    assert drive.forecast().used_j == pytest.approx(540.0)


@pytest.mark.parametrize(("end_x", "words"), [(10.0 + 1e-9, "at least 0.01 "), (10.0, "at least 0.01 ")])
def test_a_route_without_a_length_is_refused(end_x: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        flat().drive([(10.0, 20.0), (end_x, 20.0)])


def test_a_route_that_is_too_long_is_refused_before_it_is_priced() -> None:
    zigzag = [(10.0 + 100.0 * (k % 2), 20.0) for k in range(202)]
    with pytest.raises(InputError, match="at most 20000 m"):
        flat().drive(zigzag)


def test_the_sentence_says_what_the_forecast_does_where_no_cause_is_certain() -> None:
    for hill in (0.0, 0.05):
        ground = np.tile(hill * np.arange(120.0), (40, 1))
        drive = jm.costmap(jm.heightmap(ground, resolution_m=1.0), model="physics").drive([(10.0, 20.0), (110.0, 20.0)])
        planned = drive.route.energy_j / drive.route.duration_s
        for time_s, position, _ in driven(drive, 1.0):
            drive.update(time_s, position, power_w=2.0 * planned)
        now = drive.forecast()
        assert now.more.name == "level", hill
        more = 100.0 * (now.energy_j / now.planned_j - 1.0)
        assert f"{100.0 * now.more.share:.0f} % more" in now.text
        assert 100.0 * now.more.share == pytest.approx(more, abs=2.0)
        assert "J" not in now.text
