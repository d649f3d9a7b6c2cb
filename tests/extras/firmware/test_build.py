"""Where the firmware is found, and the message if something is missing."""

import shutil
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.firmware import build


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return build.cache()


def binary(folder):
    folder.mkdir(parents=True)
    file = folder / "betaflight_4.6.0_SITL"
    file.write_bytes(b"\x7fELF\x02 and more")
    return file


@pytest.mark.parametrize(
    "source", ["", "obj", "lib/python3.12/site-packages/betaflight/firmware/obj", "betaflight/firmware/obj"]
)
def test_the_binary_is_found_in_an_environment_a_package_or_the_sources(tmp_path, source):
    file = binary(tmp_path / "own" / source)
    assert build.find_binary(tmp_path / "own") == file
    assert build.find_binary(file) == file


def test_the_chosen_binary_is_remembered(cache, tmp_path, monkeypatch):
    monkeypatch.setattr(build, "_installed", lambda found: None)
    first, second = binary(tmp_path / "first"), binary(tmp_path / "second")
    assert build.choose(tmp_path / "first") == first
    assert build.program() == first
    build.choose(second)
    assert build.program() == second


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_another_program_is_refused_and_not_remembered(cache):
    with pytest.raises(BadInputError, match="true: does not run as Betaflight's simulator"):
        build.choose(Path(shutil.which("true")))
    assert not (cache / "betaflight").exists()
