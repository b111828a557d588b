"""Docstrings' examples run, every name has a docstring, and the pages show what the package does."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path

import pytest

import rigidformer as rf
from conftest import needed

HERE = Path(__file__).resolve().parent


def documented():
    """Names and docstrings of the package, its classes and their members."""
    yield "rigidformer", rf.__doc__
    for name in rf.__all__:
        member = getattr(rf, name)
        yield name, member.__doc__
        if inspect.isclass(member):
            for attribute, value in vars(member).items():
                if not attribute.startswith("_"):
                    # Plain attributes are listed by their class.
                    listed = member.__doc__ if attribute in (member.__doc__ or "") else None
                    yield f"{name}.{attribute}", value.__doc__ or listed


@pytest.mark.parametrize("name, text", list(documented()), ids=lambda value: None if value is None or " " in value else value)
def test_examples_run(name, text):
    assert text, f"{name} has no docstring"
    examples = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    flags = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL
    results = doctest.DocTestRunner(optionflags=flags).run(examples)
    assert results.failed == 0


def test_most_calls_say_what_they_raise():
    for name, text in documented():
        # What its own parameters cannot upset, or only by the types that Python checks.
        if name.split(".")[0] in {"VelocityNoise", "Mppi", "Cem", "Launch", "Commands", "Parameter"}:
            continue
        if text and "Parameters\n" in text:
            assert "Raises\n" in text, f"{name} does not say what it raises"


def test_the_listings_of_the_page_run(capsys, tmp_path, monkeypatch):
    needed("matplotlib").use("Agg")
    monkeypatch.chdir(tmp_path)
    text = (HERE.parent / "README.md").read_text()
    for listing in text.split("```python\n")[1:]:
        exec(compile(listing.split("```", 1)[0], "README.md", "exec"), {})
    assert capsys.readouterr().out.count("m\n") == 12
    assert (tmp_path / "heights.png").read_bytes().startswith(b"\x89PNG")


def test_the_example_draws(tmp_path, monkeypatch):
    needed("matplotlib")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    path = HERE.parent / "examples" / "plot.py"
    exec(compile(path.read_text(), str(path), "exec"), {"__name__": "__main__"})
    assert (tmp_path / "prediction.png").stat().st_size > 10_000
