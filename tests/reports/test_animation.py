"""The moving picture of a plan."""

from pathlib import Path

import numpy as np
from PIL import Image

from missions.gallery import FRAMES_PER_SECOND, animate_plan
from tests.network import small_plan


def test_a_plan_becomes_a_gif_in_which_the_team_moves(tmp_path: Path) -> None:
    animate_plan(small_plan().plan, tmp_path / "plan.gif", frames=6)
    with Image.open(tmp_path / "plan.gif") as picture:
        assert picture.info["duration"] == 1000 // FRAMES_PER_SECOND
        assert picture.n_frames >= 6
        frames = []
        for frame in (0, 3, 5):
            picture.seek(frame)
            frames.append(np.asarray(picture.convert("L"), dtype=float))
    assert all((frame < 200.0).any() for frame in frames)
    assert np.abs(frames[1] - frames[0]).max() > 100.0
