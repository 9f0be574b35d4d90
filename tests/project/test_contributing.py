"""What a contributor meets first: the page, the hooks before a commit, the workflow."""

import re
import stat

import pytest
from places import ROOT

yaml = pytest.importorskip("yaml", reason="extra docs")


def test_the_page_is_one_page_and_names_what_there_is():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    assert len(text.splitlines()) <= 60
    for title in ("Set up", "Run a test", "Where things are", "How a change lands"):
        assert f"## {title}\n" in text
    for name in re.findall(r"`((?:docs|tests|scripts|\.ci|\.github)/[\w./]+|\.pre\S+)`", text):
        assert (ROOT / name).exists(), name


def test_hooks_call_the_tools_of_the_environment():
    [repository] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert repository["repo"] == "local"
    tools = {hook["entry"].split()[0] for hook in repository["hooks"]}
    assert tools == {".venv/bin/ruff", ".venv/bin/mypy", ".venv/bin/lint-imports"}


def test_the_workflow_calls_what_decides_here():
    [job] = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]
    assert (ROOT / ".ci/run").stat().st_mode & stat.S_IXUSR
