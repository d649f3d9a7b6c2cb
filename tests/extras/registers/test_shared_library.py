"""Libraries of C files: compiled once, and the refusals without a compiler that works."""

import os
import shutil

import pytest

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.registers.shared_library import shared_library


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "header.h").write_text("#define ANSWER 42\n")
    file = tmp_path / "answer.c"
    file.write_text('#include "header.h"\nint answer(void) { return ANSWER; }\n')
    return file


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_a_library_is_compiled_once_and_again_after_a_change_of_a_header(source):
    header = source.with_name("header.h")
    library = shared_library(source, "this test", headers=[header])
    before = os.stat(library).st_mtime_ns
    assert shared_library(source, "this test", headers=[header]) == library
    assert os.stat(library).st_mtime_ns == before
    header.write_text("#define ANSWER 43\n")
    assert shared_library(source, "this test", headers=[header]) != library
    assert len(list(library.parent.iterdir())) == 2


def test_a_compiler_that_fails_is_quoted(source, tmp_path, monkeypatch):
    compiler = tmp_path / "bin" / "cc"
    compiler.parent.mkdir()
    compiler.write_text("#!/bin/sh\necho 'answer.c:1: no such header' >&2\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", f"{compiler.parent}:/bin:/usr/bin")
    with pytest.raises(MavfiError, match="cc: cannot compile answer.c: answer.c:1: no such header"):
        shared_library(source, "this test")
    assert not list((tmp_path / "cache" / "mavfi" / "libraries").iterdir())


def test_without_a_compiler_the_message_says_who_needs_one(source, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(BadInputError, match="no C compiler .*which this test needs"):
        shared_library(source, "this test")
