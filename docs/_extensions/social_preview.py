"""Draws the picture that forges and messengers show beside a link to the project.

    python docs/_extensions/social_preview.py

It puts the logo and the project's description over a frame of a race. It needs the game's graphics
and Chromium.
"""

from __future__ import annotations

import subprocess
import tempfile
from importlib.metadata import metadata
from pathlib import Path
from shutil import which

from gallery import FrameRecorder
from PIL import Image

from stkzoo.race import run_race

STATIC = Path(__file__).parents[1] / "_static"
SIZE = (1280, 640)
_DRIVERS = ("pretrained:zenith", *(f"ai@:AI {number}" for number in range(1, 6)))
_FRAME_SIZE, _FRAME_STEP, _KART = (854, 640), 60, 5

_PAGE = """\
<style>
  body {{ margin: 0; width: 1280px; height: 640px; font-family: sans-serif; color: #fff;
          background: #123a6b url(frame.png) no-repeat right }}
  div {{ position: absolute; inset: 0; padding: 0 760px 0 64px; display: flex;
         flex-direction: column; justify-content: center;
         background: linear-gradient(90deg, #123a6b 38%, #123a6b00 54%) }}
  img {{ width: 132px; border-radius: 32px; border: 3px solid #ffffff40 }}
  h1 {{ display: flex; align-items: center; gap: 24px; margin: 0; font-size: 84px }}
  p {{ margin: 32px 0 0; font-size: 34px; line-height: 1.35 }}
</style>
<body><div>
  <h1><img src="{logo}">stkzoo</h1>
  <p>{description}</p>
</div></body>
"""


def main() -> None:
    """Writes ``social-preview.png``."""
    recorder = FrameRecorder(_FRAME_SIZE, _FRAME_STEP, _KART)
    run_race(_DRIVERS, track="hacienda", seed=1, max_steps=_FRAME_STEP, listeners=[recorder])
    browser = which("chromium") or which("google-chrome")
    if recorder.frame is None or browser is None:
        raise SystemExit("the picture needs the game's graphics and Chromium")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Image.fromarray(recorder.frame).save(folder / "frame.png")
        text = _PAGE.format(
            logo=(STATIC / "logo.svg").as_uri(), description=metadata("stkzoo")["Summary"]
        )
        (folder / "page.html").write_text(text, "utf-8")
        flags = (
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            "--allow-file-access-from-files",
        )
        size = f"--window-size={SIZE[0]},{SIZE[1]}"
        target = folder / "picture.png"
        page = (folder / "page.html").as_uri()
        command = [browser, *flags, size, f"--screenshot={target}", page]
        subprocess.run(command, check=True)  # noqa: S603 - a page of our own
        picture = Image.open(target).convert("RGB")
        colors = picture.quantize(256, Image.Quantize.MAXCOVERAGE)  # keeps those of the logo
        picture.quantize(palette=colors).save(STATIC / "social-preview.png", optimize=True)


if __name__ == "__main__":
    main()
