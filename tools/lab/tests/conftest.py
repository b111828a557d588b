"""What several tests check alike."""

import importlib
import os

import pytest


def needed(name, reason=None):
    """A package without which tests are skipped, but where a command of `cargo xtask` says that all of them is there."""
    if os.environ.get("RIGIDFORMER_COMPLETE"):
        return importlib.import_module(name)
    return pytest.importorskip(name, reason=reason)


@pytest.fixture
def resumes(tmp_path, monkeypatch):
    """Interrupts a recipe of two shards, refuses another one there, and continues: the file must be that of a run that was
    not interrupted."""
    # Here, so that tests without engines need none.
    from rigidformer_lab import movi
    from rigidformer_lab.movi import generate
    from rigidformer_lab.scenes import SceneFileError

    def check(recipe, another):
        assert len(recipe.shards()) == 2
        generate(recipe, tmp_path / "whole", 1)
        real = movi.concatenate

        def interrupt(parts):
            raise KeyboardInterrupt

        monkeypatch.setattr(movi, "concatenate", interrupt)
        with pytest.raises(KeyboardInterrupt):
            generate(recipe, tmp_path / "resumed", 1)
        sorted((tmp_path / "resumed.parts").glob("seeds-*"))[1].unlink()
        with pytest.raises(SceneFileError, match="other arguments"):
            generate(another, tmp_path / "resumed", 1)
        monkeypatch.setattr(movi, "concatenate", real)
        generate(recipe, tmp_path / "resumed", 1)
        assert (tmp_path / "resumed").read_bytes() == (tmp_path / "whole").read_bytes()

    return check


@pytest.fixture
def makes_splits(tmp_path, capsys):
    """Runs a command that makes scenes: by seed they are for training, validation and tests, with `--split` all for one of them."""
    from rigidformer_lab.scenes import TEST, TRAIN, VALIDATION, read_scenes

    def check(main, *before, says="3 scenes"):
        out = tmp_path / "x"
        few = [*map(str, before), "--seeds", "3", "--first-seed", "8", "--frames", "2", "--workers", "1", "--out", str(out)]
        assert main(few) == 0
        assert says in capsys.readouterr().out
        assert read_scenes(out).scene_split.tolist() == [TRAIN, VALIDATION, TEST]
        assert main([*few, "--split", "test"]) == 0
        assert read_scenes(out).scene_split.tolist() == [TEST] * 3
        with pytest.raises(SystemExit):
            main([*map(str, before), "--out", str(out), "--seeds", "0"])
        assert "at least 1" in capsys.readouterr().err

    return check
