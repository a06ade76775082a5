"""What an adapter leaves in the kit's folder is removed, whatever it is, and nothing that it leads to."""

from __future__ import annotations

import os
from pathlib import Path

from pytest_otmcp.core.files import remove_tree


def test_a_folder_is_removed_however_deep_it_is_and_whatever_is_in_it(tmp_path: Path) -> None:
    folder, outside = tmp_path / "work", tmp_path / "outside"
    folder.mkdir()
    outside.mkdir()
    (outside / "file").write_text("stays")
    at = os.open(folder, os.O_RDONLY)
    # Python follows no more than a thousand of its own calls.
    for _ in range(1200):
        os.mkdir("d", dir_fd=at)
        os.symlink(outside, "a link", dir_fd=at)
        at, above = os.open("d", os.O_RDONLY, dir_fd=at), at
        os.close(above)
    os.mkfifo("a pipe", dir_fd=at)
    os.close(at)
    (folder / "otmcp-0").mkdir()
    (folder / "otmcp-1").write_text("has such a name")
    os.chmod(folder / "d" / "d", 0)
    os.chmod(folder / "d", 0)
    remove_tree(str(folder))
    assert os.listdir(tmp_path) == ["outside"]
    assert (outside / "file").read_text() == "stays"


def test_of_a_folder_that_is_not_there_nothing_is_removed(tmp_path: Path) -> None:
    remove_tree(str(tmp_path / "work"))
    (tmp_path / "link").symlink_to(tmp_path)
    remove_tree(str(tmp_path / "link"))
    assert os.listdir(tmp_path) == ["link"]
