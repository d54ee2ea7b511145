"""Workflows, issue forms and citation agree with Makefile and pyproject.toml. `make lint` checks their schemas."""

import re

import pytest
import yaml
from pages import ROOT

import wbc_controller

PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def load(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


JOBS = load(".github/workflows/checks.yml")["jobs"]


def test_the_workflow_runs_the_checks_on_all_supported_pythons_by_targets_of_the_makefile():
    supported = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)
    assert JOBS["tests"]["strategy"]["matrix"]["python"] == supported
    assert ".ci/run" in [step.get("run") for step in JOBS["tests"]["steps"]]
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    commands = [step["run"] for job in JOBS.values() for step in job["steps"] if "run" in step]
    run = {command.removeprefix("make ") for command in commands if command.startswith("make ")}
    assert run == {"site", "dist", "test-kilted"}
    assert run <= targets


@pytest.mark.parametrize("form", ["bug", "feature"])
def test_issue_forms_request_version_check_and_recording(form):
    parts = load(f".github/ISSUE_TEMPLATE/{form}.yml")["body"]
    texts = " ".join(str(part["attributes"]) for part in parts)
    for word in ("wbc --version", "wbc check", "recording"):
        assert word in texts
    required = {part["id"] for part in parts if part.get("validations", {}).get("required")}
    assert required >= ({"version", "check", "recording"} if form == "bug" else {"version"})


def test_citation_has_version_licence_and_address_of_the_package():
    citation = load("CITATION.cff")
    assert citation["version"] == wbc_controller.__version__
    assert f'license="{citation["license"]}"' in (ROOT / "setup.py").read_text(encoding="utf-8")
    assert f'Repository = "{citation["repository-code"]}"' in PYPROJECT


@pytest.mark.parametrize("page", ["SECURITY.md", "CODE_OF_CONDUCT.md"])
def test_pages_name_the_contact_of_the_package_and_existing_files(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    (contact,) = set(re.findall(r"<(\S+@\S+)>", text))
    assert f'email = "{contact}"' in PYPROJECT
    for link in re.findall(r"\]\((docs/[^)#]+)", text):
        assert (ROOT / link).exists(), link


@pytest.mark.parametrize("robot", ["g1", "go2", "talos"])
def test_shipped_configurations_have_no_empty_section(robot):
    """The parser of ROS 2 parameter files refuses them."""
    assert "{}" not in yaml.safe_dump(load(f"config/{robot}.yaml"))
