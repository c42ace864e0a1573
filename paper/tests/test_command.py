"""``hybrid report``."""

import pytest
from typer.testing import CliRunner

import hybrid as hy
from hybrid import gallery
from hybrid.cli import app


def call(*words):
    return CliRunner().invoke(app, ["report", *map(str, words)])


def test_report_says_its_verdicts_and_writes_the_page(tmp_path):
    """A line a claim; a section that is not there is refused before anything runs."""
    done = call("--out", tmp_path / "paper", *["--only", "existence"] * 2)
    assert done.exit_code == 0, done.output
    assert "reproduced" in done.output
    assert done.output.count("Existence of chattering") == 1
    assert (tmp_path / "paper" / "index.html").stat().st_size > 1_000_000
    assert (tmp_path / "paper" / "figures" / "example-1.png").exists()
    refused = call("--out", tmp_path, "--only", "preface")
    assert refused.exit_code == 2
    assert "no section 'preface'" in refused.output
    (tmp_path / "file").write_text("")
    refused = call("--out", tmp_path / "file")
    assert refused.exit_code == 2
    assert f"cannot write the page to {tmp_path / 'file'}: Not a directory" in refused.output
    assert refused.stderr.count("\n") == 1
    never = call("--out", tmp_path / "never", "--only", "preface")
    assert never.exit_code == 2
    assert not (tmp_path / "never").exists()


def test_without_a_checkout_it_says_where_it_is(tmp_path, monkeypatch):
    """One line, and nothing is written."""
    monkeypatch.setattr(gallery, "__file__", str(tmp_path / "site-packages/hybrid/gallery.py"))
    done = call("--out", tmp_path / "page")
    assert done.exit_code == 2
    assert "folder paper/ of a checkout" in done.stderr
    assert not (tmp_path / "page").exists()


def test_the_study_says_where_it_went():
    """The name that it had is no public name any more."""
    assert "study" not in hy.__all__
    with pytest.raises(AttributeError, match=r"paper\.transient"):
        hy.study  # noqa: B018
