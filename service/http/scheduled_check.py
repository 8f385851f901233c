"""`joulemap check` on a schedule: what is wrong is written to the log and counted, and nothing is changed."""

from __future__ import annotations

import logging
import threading

from sqlalchemy.exc import SQLAlchemyError

from joulemap.service.hosting.priority import JOB_NICE, be_nice
from joulemap.service.hosting.settings import Settings
from joulemap.service.schemas.kept import ANSWERS
from joulemap.service.storage.check import Check
from joulemap.service.storage.store import Store

_LOG = logging.getLogger("joulemap.service")


class ScheduledCheck:
    """Looks through the data directory every `check_every_h` hours, on a thread that lets others go first."""

    def __init__(self, settings: Settings, store: Store) -> None:
        self._settings, self._store, self._over = settings, store, threading.Event()
        self.found = 0
        """How much was wrong at the latest look."""

    def start(self) -> None:
        """Begin to wait for the first look, where one is wanted."""
        if self._settings.check_every_h is not None:
            threading.Thread(target=self._repeat, name="check", daemon=True).start()

    def stop(self) -> None:
        """End; a look ends before its next row."""
        self._over.set()

    def _repeat(self) -> None:
        be_nice(JOB_NICE)
        while not self._over.wait(3600.0 * (self._settings.check_every_h or 0.0)):
            try:
                self._look()
            except (SQLAlchemyError, OSError) as error:  # a database or an object store that is away, or a stop
                _LOG.warning("the check of what is kept did not end: %s", error)

    def _look(self) -> None:
        settings, found = self._settings, 0
        looking = Check(self._store, settings.data_dir, settings.resolved_models_dir, answers=ANSWERS)
        for finding in looking.findings():
            if self._over.is_set():
                return
            found += 1
            remedy = (
                "restore it from a backup" if finding.remedy is None else "stop the service, `joulemap check --repair`"
            )
            _LOG.error("check: %s: %s: %s (%s)", finding.kind, finding.what, finding.words, remedy)
        self.found = found
        _LOG.info("check: %s", f"{found} findings" if found else "nothing is wrong")
