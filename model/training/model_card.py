"""Model cards of the shipped network and of models of measured runs, written by their trainings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joulemap.model.energy.domain import Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.uncertainty import LEVELS, Spread

_METHODS = {
    "physics_declared": "eq. 5, declared rolling resistance",
    "physics_fitted_to_each_run": "eq. 5, resistance fitted to that very run",
}


def model_card(version: str, parameters: int, training: Mapping[str, Any], domain: Domain, spread: Spread) -> str:
    """Write the model card."""
    options = training["options"]
    rows = [("this network", training["held_out"])]
    rows += [(_METHODS[name], found) for name, found in training["baselines"].items()]
    table = "\n".join(
        f"| {name} | {100 * e['mean_relative_error']:.1f} % | {100 * e['median_relative_error']:.1f} % | "
        f"{100 * e['route_relative_error']:.1f} % | {e['rmse_j']:.1f} | {e['bias_j']:+.1f} |"
        for name, e in rows
    )
    ranges = {**domain.robot, "resolution [m/pixel]": domain.resolution_m, "slope [deg]": (0.0, domain.max_slope_deg)}
    learned = "\n".join(f"| {name} | {low:.3g} .. {high:.3g} |" for name, (low, high) in ranges.items())
    covered = ", ".join(f"{share:.0%} (of {level} %)" for level, share in training["coverage"].items())
    metres = spread.correlation_m
    return f"""# Model card: the network that joulemap ships

Compact network (`model/energy/architectures/compact`), {parameters:,} parameters.
Version `{version}`, {training["made"]}.

## What it answers
The traction demand per metre and heading of a wheeled, skid-steer ground robot, and its uncertainty, from a heightmap
and the robot's file. Climbing and rolling are equation 5 of Wei & Isler 2022 with gains that depend on the robot. The
network adds what the ground costs beyond that, from the heights under the wheel tracks and in the 2 m square around a
place. `rolling_resistance` in the robot file means equation 5's mu *at the battery*: the energy of motion on level,
even ground of this kind, per metre and newton of weight. Turning is not included; it has a price of its own
(`turn_j_per_rad`).

## Data
No measured run. {training["segments"]:,} segments of 1 m, driven by {training["robots"]:,} simulated robots over
{training["sites"]:,} simulated sites (30 x 30 m, slopes to {domain.max_slope_deg:.0f} degrees; a fifth of them smooth),
surveyed at 0.05 to 1 m per pixel: half of them as by a scanner, with up to 12 mm of noise, the others with 8 to 160 mm,
of which a quarter is alike over 0.1 to 1 m; half of them blurred, half without the finest relief, some rounded to 1 mm,
1 cm or 10 cm. The network reads what is left when the estimated noise has been taken out, and knows how much that
was. The simulation (`model/field`) shares no formula with the
network. What no file says (true mass, drivetrain, bump loss, wheelbase ...) is drawn for every robot and ground. The
declared rolling resistance is right to about 8 %. Segments that turn by more than 0.25 rad are left out. Data hash
`{training["data_hash"]}`, seed {training["seed"]}.

Made by `{training["command"]}`: {training["epochs"]} epochs, batch {options["batch"]}, AdamW at
{options["learning_rate"]} falling as a cosine, augmented by quarter turns and mirror images; the weights are those with
the least error on sites that were not trained on.

## Held-out error
On {training["held_out"]["segments"]:,} segments of {training["held_out_sites"]} further sites and their robots, which
neither training nor stopping used (robots without regeneration, so that the paper's relative error |e_hat - e| / e is
defined everywhere):

| model | mean error | median | whole runs | rmse [J] | bias [J] |
|---|---|---|---|---|---|
{table}

The resistance fitted to a run fits the run's sum, but not its segments: least squares follow the expensive segments,
and on slopes braking and drivetrain losses make the relation non-linear.

The intervals held {covered} of the same segments
(their widths were found on them: factor {spread.factor:.2f}, quantiles {_quantiles(spread)}).
Each whole run has errors of its own, from properties of robot and ground that the network does not know and from what
the survey does not show: of {100 * spread.run_share:.1f} % of its energy and of {spread.run_std_share:.2f} times the
sum of the standard deviations of its segments (scales of Student's t with {_freedom(spread.run_freedom)} degrees of
freedom).
Half of the routes take {100 * spread.bias:+.0f} % or less against the prediction; errors above that are
{spread.skew:.1f} times those below it. Errors of neighbouring segments are correlated over {metres:.1f} m.

## Learned ranges
Outside of them the answer comes with a warning, and the network clamps the robot's values to the range.

| | range |
|---|---|
{learned}

## Limits
- It has seen no real ground. For yours, train on some runs of your robot (`joulemap train` starts from this network).
- It is not exactly equivariant: turning or mirroring the map changes a price by a few percent.
- A place whose surrounding 2 m square touches an unknown height has no answer.
- At 1 m per pixel it knows how rough such ground usually is, but not how rough this ground is.
"""


def card_of_runs(version: str, training: Mapping[str, Any], domain: Domain, costs: DriveCosts) -> str:
    """Write the model card of a model that was trained on measured runs."""
    rows = [("this model", training["held_out"]), *training["baselines"].items()]
    table = "\n".join(
        f"| {name} | {e['rmse_j']:.4g} | {e['mean_absolute_error_j']:.4g} | {100 * e['error_share']:.1f} % | "
        f"{100 * e['route_relative_error']:.1f} % |"
        for name, e in rows
    )
    driven = "\n".join(f"| {name} | {low:.3g} .. {high:.3g} |" for name, (low, high) in domain.driven.items())
    warnings = "".join(f"\n**{warning[:1].upper()}{warning[1:]}.**\n" for warning in training["warnings"])
    used, robot, runs = training["coverage"], training["robot"], ", ".join(training["runs"])
    return f"""# Model card: a model of measured runs

Version `{version}`, trained on runs of {robot["name"]} ({robot["mass_kg"]:g} kg): {runs}.
{used["used_m"]:.0f} of {used["track_m"]:.0f} m of track were used.
It was started from `{training["started_from"] or "random weights"}`, seed {training["seed"]}.
{warnings}
## Held-out error
Runs {", ".join(training["held_out_runs"])}, each predicted by a fit that had not seen it:

| model | root mean square [J] | mean absolute [J] | of the energy | whole runs |
|---|---|---|---|---|
{table}

## Costs beside the ground
Turning costs {costs.turn_j_per_rad:.4g} J/rad, in plans too.
Speeding up costs {costs.speed_up_kg:.4g} J for each m2/s2 of half the squared speed.
Driving takes {costs.driving_w or 0.0:.4g} W beyond the declared idle power, for the time beyond that at the declared
speed.

## What the runs showed
The middle 98 % of the metres:

| | range |
|---|---|
{driven}
"""


def _freedom(freedom: float | None) -> str:
    return "more than 100" if freedom is None else f"{freedom:.0f}"


def _quantiles(spread: Spread) -> str:
    return ", ".join(f"{q:.2f} at {level:.0%}" for level, q in zip(LEVELS, spread.quantiles, strict=True))
