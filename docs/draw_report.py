"""Draws docs/images/report.png, the picture of a report in the README, with chromium: `python docs/draw_report.py`.

The report is the demonstration's: `make demo` first, or give another `report.html`.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

WIDTH, HEIGHT, COLOURS = 1000, 965, 64
TO = Path(__file__).parent / "images" / "report.png"


def picture(report: Path, width: int = WIDTH, height: int = HEIGHT) -> Image.Image:
    """The first screen of a page."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        raise SystemExit("draw_report: chromium was not found; install it.")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        command += [
            f"--user-data-dir={folder}/profile",
            f"--window-size={width},{height}",
            f"--screenshot={shot}",
        ]
        subprocess.run([*command, report.resolve().as_uri()], check=True, capture_output=True, timeout=120)
        return Image.open(io.BytesIO(shot.read_bytes()))


if __name__ == "__main__":
    given = Path(sys.argv[1] if len(sys.argv) > 1 else "results/demo/arm/report.html")
    if not given.is_file():
        raise SystemExit(f"draw_report: {given} is not there; run `make demo` first, or give a report.html.")
    picture(given).convert("RGB").quantize(COLOURS).save(TO, optimize=True)
    print(TO)
