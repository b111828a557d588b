"""What the recipe starts."""

import subprocess
import sys

import pytest

from rigidformer_lab import recipe

BAIT = "import pathlib; pathlib.Path(__file__).with_name('ran').touch()"


def test_the_recipe_runs_nothing_of_the_current_folder(tmp_path, monkeypatch):
    (tmp_path / "rigidformer_lab").mkdir()
    for name in ("rigidformer_lab/__init__.py", "rigidformer_lab/recipe.py", "argparse.py", "sitecustomize.py"):
        (tmp_path / name).write_text(BAIT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    recipe.run(recipe.module("recipe", "--help"))
    assert not list(tmp_path.rglob("ran"))
    subprocess.run([sys.executable, "-m", "rigidformer_lab.recipe"], env={}, check=True)
    assert list(tmp_path.rglob("ran")), "the files of this test are no bait"


def test_a_command_that_fails_ends_the_recipe():
    with pytest.raises(subprocess.CalledProcessError):
        recipe.run(recipe.module("recipe", "--no-such-option"))
