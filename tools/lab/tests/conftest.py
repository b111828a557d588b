"""What several tests check alike."""

import pytest

from rigidformer_lab import movi
from rigidformer_lab.movi import generate
from rigidformer_lab.scenes import SceneFileError


@pytest.fixture
def resumes(tmp_path, monkeypatch):
    """Interrupts a recipe of two shards, refuses another one there, and continues: the file must be that of a run that was
    not interrupted."""

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
