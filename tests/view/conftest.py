import shutil
import subprocess

import pytest


class Opened:
    """What a page said on the console, and how it looked."""

    def __init__(self, said, picture, log):
        self.said, self.picture, self.log = said, picture, log

    @property
    def errors(self):
        return [line for line in self.said if "rror" in line]


@pytest.fixture
def chromium(tmp_path):
    """Opens a file in headless Chromium without a network."""
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    if program is None:
        pytest.skip("no Chromium is installed")

    def open_(path):
        picture = tmp_path / "picture.png"
        arguments = [
            *(program, "--headless=new", "--no-sandbox", "--enable-logging=stderr"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"),
            *("--host-resolver-rules=MAP * ~NOTFOUND", "--window-size=400,300"),
            *(f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=3000"),
            *(f"--screenshot={picture}", path.as_uri()),
        ]
        try:
            done = subprocess.run(
                arguments, capture_output=True, text=True, timeout=120, check=False
            )
        except subprocess.TimeoutExpired:
            pytest.skip("Chromium did not finish within two minutes")
        said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
        return Opened(said, picture, done.stderr)

    return open_
