"""Rate limit of log messages about incoming messages."""

from wbc_controller.middleware import log_limit
from wbc_controller.middleware.log_limit import LogLimit


def test_one_message_per_second_and_topic_passes(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(log_limit.time, "monotonic", lambda: now[0])
    limit, passed = LogLimit(), []
    for i in range(2500):
        now[0] = 0.001 * i
        passed += [(topic, i) for topic in ("a", "b") if (topic == "a" or i >= 500) and limit.passes(topic)]
    assert passed == [("a", 0), ("b", 500), ("a", 1000), ("b", 1500), ("a", 2000)]
