"""SROS 2 policies as dictionaries."""

from xml.etree import ElementTree


def read_policy(text: str) -> dict[str, dict[str, set[str]]]:
    """Names of each enclave by `publish`, `subscribe`, `request` and `reply`."""
    allowed: dict[str, dict[str, set[str]]] = {}
    for enclave in ElementTree.fromstring(text).iter("enclave"):  # noqa: S314 - made by the code under test
        rules = allowed[enclave.get("path", "")] = {}
        for group in enclave.iter():
            for qualifier in ("publish", "subscribe", "request", "reply"):
                if group.get(qualifier) == "ALLOW":
                    names = [element.text or "" for element in group]
                    assert len(names) == len(set(names))
                    rules.setdefault(qualifier, set()).update(names)
    return allowed
