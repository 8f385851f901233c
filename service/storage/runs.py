"""Measured runs that are kept, as they were sent."""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from joulemap.model.errors import ConflictError
from joulemap.service.storage.kept import Kept, now
from joulemap.service.storage.tables import (
    CalibrationRow,
    RunsRow,
    named_test_runs,
)

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


class KeptRuns(Kept):
    """Rows of runs that were sent together, and a folder of each."""

    def add_runs(self, files: Sequence[tuple[str, Path]], stats: list[dict[str, Any]]) -> RunsRow:
        """Keep runs that were sent together, so that no row is ever without its files."""
        row = RunsRow(id=f"runs-{secrets.token_hex(6)}", created_at=now(), stats=stats)
        begun = self._folder.uploads / row.id
        begun.mkdir()
        try:
            for name, file in files:
                shutil.copyfile(file, begun / safe_name(name))
            self._keep_with(row, begun, self.runs_folder(row.id))
        finally:
            shutil.rmtree(begun, ignore_errors=True)
        return row

    def runs(self, runs_id: str) -> RunsRow:
        """Return the row of runs that were sent together. Raises NotFoundError if there is none."""
        return self._row(RunsRow, "are no runs", runs_id=runs_id)

    def run_files(self, runs_id: str) -> list[Path]:
        """Return the files of runs that were sent together. Raises NotFoundError if there is none."""
        return sorted(self.here(self.runs_folder(self.runs(runs_id).id)).iterdir())

    def all_runs(self, *, limit: int, offset: int) -> tuple[list[RunsRow], int]:
        """Return one page of the uploads of runs, newest first.

        Returns `rows`: those of the page; `total`: how many there are in all.
        """
        return self._page(RunsRow, limit, offset)

    def delete_runs(self, runs_id: str) -> None:
        """Delete runs that no calibration uses.

        Raises NotFoundError if there are none; ConflictError if calibrations use them; their ids are in the context.
        """
        row = self.runs(runs_id)

        def _unless_used(session: Session) -> None:
            made = session.execute(select(CalibrationRow.id, CalibrationRow.request)).all()
            users = sorted(
                job_id
                for job_id, asked in made
                if runs_id in (*asked["runs"], *asked.get("base_runs", []), *named_test_runs(asked))
            )
            if users:
                raise ConflictError(
                    f"runs {runs_id} are used by {len(users)} calibration(s), {', '.join(users[:5])}: "
                    "delete them first",
                    calibration_ids=users,
                )
            session.delete(row)

        self._delete(_unless_used)
        self._forget(self.runs_folder(runs_id))

    def runs_folder(self, runs_id: str) -> Path:
        """Return the folder of runs that were sent together."""
        return self._dir / "runs" / runs_id


def safe_name(name: str) -> str:
    """Return a name that a file of the data directory may have.

    Result: letters, digits, dots, hyphens and underscores; at most 100.
    """
    return _UNSAFE.sub("_", name).lstrip(".")[-100:] or "run"
