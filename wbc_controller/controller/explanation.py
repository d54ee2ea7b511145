"""Concurrent search for the conflicting constraints of a failure."""

import logging
import math
from concurrent.futures import Future, ThreadPoolExecutor

from wbc_controller.errors import NoSolution

_log = logging.getLogger(__name__)

_PAUSE = 1.0  # shortest time between two searches, s


class FailureExplanation:
    """Search on a thread, which takes several periods."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="explain")
        self._search: Future[NoSolution] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget the failure, and permit a search at once."""
        self.failure: NoSolution | None = None  # to be explained
        self._begun = -math.inf  # of the last search, s

    def begin(self, now: float) -> None:
        """Begin a search for a new failure, unless another search is under way or has just begun; `now` in s."""
        failure, self.failure = self.failure, None
        if failure is not None and self._search is None and now - self._begun >= _PAUSE:
            self._begun = now
            self._search = self._executor.submit(failure.explained)

    def take(self) -> NoSolution | None:
        """Return the explained failure of a completed search, once."""
        if self._search is None or not self._search.done():
            return None
        search, self._search = self._search, None
        try:
            return search.result()
        except Exception:
            _log.exception("the search for conflicting constraints failed")
            return None
