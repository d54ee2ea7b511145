"""Results of `wbc bench latency`."""

from typing import Any

from wbc_controller.validation.latency.latency import Latency
from wbc_controller.validation.latency.meter import RoundTrips

_NAMES = ("median", "p99", "p99.9")


def figures(found: Latency) -> dict[str, Any]:
    """Return the results by name and unit, for a file."""
    ours, bare = found.controller, found.echo
    return {
        "rate_hz": 1.0 / ours.period,
        "controller_us": _microseconds(ours.quantiles),
        "echo_us": _microseconds(bare.quantiles),
        "difference_us": _microseconds(_difference(found)),
        "controller": _counts(ours),
        "echo": _counts(bare),
        "controller_processor_share": {"active": found.active, "inactive": found.inactive},
        "controller_waiting_share": found.waiting,
        "controller_memory_kb": list(found.memory),
        "states_delayed_us": _microseconds(ours.delay_quantiles),
        "scheduling": found.scheduling,
        "inactive_states": list(found.inactive_states),
    }


def lines(found: Latency) -> list[str]:
    """Return the results as lines of text."""
    ours, bare = found.controller, found.echo
    rows = {"controller": ours.quantiles, "bare echo": bare.quantiles, "difference": _difference(found)}
    table = [f"{'us':12}" + "".join(f"{name:>9}" for name in _NAMES)]
    table += [f"{name:12}" + "".join(f"{1e6 * value:9.0f}" for value in row) for name, row in rows.items()]
    first, last = (kilobytes / 1024.0 for kilobytes in found.memory)
    delays = [f"{name} {1e6 * value:.0f} us" for name, value in zip(_NAMES, ours.delay_quantiles, strict=True)]
    inactive_states = ", ".join(dict.fromkeys(found.inactive_states))
    return [
        *table,
        f"late: {_late(ours)} at {1.0 / ours.period:g} Hz, echo {_late(bare)}",
        f"controller: {100.0 * found.active:.1f} % of one processor active, {100.0 * found.inactive:.1f} % inactive; "
        f"{first:.1f} MB at the start, {last:.1f} MB at the end; {found.scheduling}",
        f"machine: delay of states beyond the period {', '.join(delays)}; the controller's threads "
        f"waited for a processor for {100.0 * found.waiting:.2f} % of the time",
        *([f"inactive states of the controller: {inactive_states}"] if inactive_states else []),
    ]


def _difference(found: Latency) -> tuple[float, ...]:
    return tuple(a - b for a, b in zip(found.controller.quantiles, found.echo.quantiles, strict=True))


def _late(trips: RoundTrips) -> str:
    count = trips.seconds.size
    return f"{100.0 * trips.late / count:.3f} % of {count} states ({trips.unanswered} without torques)"


def _counts(trips: RoundTrips) -> dict[str, int]:
    return {"states": trips.seconds.size, "late": trips.late, "without_torques": trips.unanswered}


def _microseconds(values: tuple[float, ...]) -> dict[str, float]:
    return {name: 1e6 * value for name, value in zip(_NAMES, values, strict=True)}
