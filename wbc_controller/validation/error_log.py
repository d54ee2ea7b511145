"""Logged errors of a trial."""

import contextlib
import logging
from collections.abc import Iterator


@contextlib.contextmanager
def logged_errors() -> Iterator[list[str]]:
    """Collect the logged errors of this package, and print nothing."""
    logger, errors = logging.getLogger("wbc_controller"), list[str]()

    def emit(record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        errors.append(f"{record.getMessage()}: {type(error).__name__}: {error}")

    handler = logging.Handler(logging.ERROR)
    handler.emit = emit  # type: ignore[method-assign]
    level, propagate = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.ERROR)
    logger.propagate = False
    try:
        yield errors
    finally:
        logger.propagate = propagate
        logger.setLevel(level)
        logger.removeHandler(handler)
