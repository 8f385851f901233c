"""What a calibrated model adds to its base model: its terms, and the rows that they may read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from joulemap.model.energy.uncertainty import Spread
from joulemap.model.loop.forms._base_parameters import BaseParameters, with_base_parameters, with_forces
from joulemap.model.loop.forms.log_faults import LogFault
from joulemap.model.loop.forms.terrain_class import TerrainClass
from joulemap.model.loop.terms import Term, energy_of
from joulemap.model.runs.features import Drives, Features, FloatArray, quantity, share_beyond


@dataclass(frozen=True)
class Correction:
    """What a calibration adds to a base model."""

    terms: tuple[Term, ...]  # Base parameters and effects, for measured runs
    planner_terms: tuple[Term, ...]  # The same without what is not known before a drive, fitted for themselves
    # Lowest and highest value of every quantity in the runs. Beyond, the border's value holds, but for a law
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # As fitted. Plans are made at the speed at which motors take what a battery gives
    drives: Drives = field(default_factory=Drives)
    first_base: Term | None = None  # The base parameters before any effect, which forms take for the energy of motion
    charge: bool = False  # Whether the scale of the base prediction is unknown, so that the terms replace it
    turn_j_per_rad: float = 0.0  # Cost of turning in plans [J/rad], in addition to the robot's own
    # Logged columns at which plans are made unless others are given: their means on the runs
    conditions: Mapping[str, float] = field(default_factory=dict)
    evidence: Sequence[Mapping[str, Any]] = ()  # The report's effects, JSON-able
    spread: Spread | None = None  # Errors on left-out runs. Its factor is that on `std_of_segments`
    # By which the energy of measured runs, and of plans, is multiplied so that sums of left-out runs agree
    scale: float = 1.0
    planner_scale: float = 1.0
    # Whether the terms of plans take the place of the base model; without any, plans use the model before
    alone: bool = False
    reliability: Mapping[str, Any] | None = None  # Of the spread, as `Reliability.as_dict`
    drive_prior: Mapping[str, Any] | None = None  # What is known of a run before it is driven, as `DrivePrior.as_dict`
    # What is added to the cost of turning on a kind of ground [J/rad], by name
    turn_by_kind: Mapping[str, float] = field(default_factory=dict)
    drivetrain_efficiency: float | None = None  # Of the robot of the runs, 0 where it declared none
    heightmaps: tuple[str, ...] = ()  # Hashes of those on which the runs were driven

    @property
    def effects(self) -> list[dict[str, Any]]:
        """What is added to measured runs, JSON-able."""
        return [t.as_dict() for t in self.terms]

    @property
    def only_in_logs(self) -> list[str]:
        """Titles of the effects that no plan contains, because only a log records what they depend on."""
        planned = {t.form.name for t in self.planner_terms}
        if self.alone:
            return []
        return [t.form.title for t in self.terms if t.form.name not in planned and t.form.on_map]

    def added_energy(self, rows: Features, *, planned: bool) -> FloatArray:
        """Return the energy that is added to rows, by all terms or by those of plans.

        Result (n,): energy [J], or charge [A s], of rows that are held within the ranges and have the base parameters
        in their energy of motion.
        """
        first = self.first_base
        level = first is not None and isinstance(first.form, BaseParameters) and first.form.level
        if not (planned and self.alone):
            return self._by_terms(self.planner_terms if planned else self.terms, rows, level)
        plain = replace(rows, drives=Drives())
        total = plain.predicted
        if self.planner_terms:  # of slopes that no run has shown, the base model knows what they cost
            flat = plain.tilted(-plain.grade) if level else plain
            held = flat.within({name: ends for name, ends in self.ranges.items() if name == "speed"})
            total = energy_of(self.planner_terms, held) + plain.predicted - flat.predicted
        return total if self.charge else total - rows.predicted

    def _by_terms(self, terms: Sequence[Term], rows: Features, level: bool) -> FloatArray:
        first = self.first_base
        held = (rows.tilted(-rows.grade) if level else rows).within(
            {name: ends for name, ends in self.ranges.items() if name not in self.of_laws}
        )
        if first is None:
            return energy_of(terms, held)
        forces, others = [t.energy for t in terms if t.form.resists], [t for t in terms if t.form.on_map]
        resisted, _ = with_forces(held, first.coefficients, first.form, terms[0].by_name, forces)

        def _drawn(of: Features) -> FloatArray:
            drawn = energy_of(others, with_base_parameters(of, first.form, first.coefficients))
            return drawn if self.charge else drawn + of.predicted

        added = _drawn(resisted) - (held.base_motion - rows.base_motion if self.charge else held.predicted)
        for form, size in ((t.form, np.asarray(t.coefficients)) for t in terms):
            if isinstance(form, LogFault):
                added += form.simulated(resisted, size, _drawn)
        return added

    @property
    def kinds(self) -> dict[str, float]:
        """Kinds of ground whose cost the runs showed, and the share of the metres on each; empty without any."""
        for form in (term.form for term in self.planner_terms):
            if isinstance(form, TerrainClass) and form.known_before and form.reference:
                return {form.reference: 1.0 - sum(form.shares), **dict(zip(form.classes, form.shares, strict=True))}
        return {}

    @property
    def of_laws(self) -> set[str]:
        """Quantities on which laws of physics depend: these hold beyond what the runs have shown."""
        laws = (term.form for term in (*self.terms, *self.planner_terms) if term.form.extrapolates)
        return {name for form in laws for name in form.covariates}

    def beyond(self, rows: Features) -> dict[str, float]:
        """Return which quantities of some rows are outside the ranges of the runs.

        Result: share of the rows whose value lies beyond, by quantity that an effect depends on; only shares above 0.
        """
        used = {name for term in self.planner_terms for name in term.form.covariates}
        names = sorted({"speed", "grade", *used} & set(self.ranges))
        shares = {name: share_beyond(quantity(rows, name), *self.ranges[name]) for name in names}
        return {name: share for name, share in shares.items() if share > 0.0}
