"""Writing whole or not at all, finding images, listing folders."""

import contextlib
import errno
import os
import resource
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

import jaxisp.io
from jaxisp.errors import InputError
from jaxisp.io import read_image, read_jpeg, read_raw
from jaxisp.io.digests import digest_of
from jaxisp.io.files import (
    atomic_write,
    check_file,
    filled_folder,
    find_images,
    list_folder,
    load_npy,
    output_file,
    output_folder,
    read_json,
    read_toml,
    write_text,
)
from jaxisp.io.locks import locked


def put(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


def test_atomic_write(tmp_path):
    path = tmp_path / "a.bin"
    for content in (b"one", b"two"):
        with atomic_write(path) as file:
            file.write(content)
            assert not path.exists() or path.read_bytes() == b"one"
        assert path.read_bytes() == content
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask


@pytest.mark.parametrize("error", [RuntimeError("stop"), KeyboardInterrupt()])
def test_nothing_is_left_after_an_error(tmp_path, error):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(type(error)), atomic_write(path) as file:
        file.write(b"half")
        raise error
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS])
def test_full_disk_is_one_line(tmp_path, monkeypatch, code):
    path = tmp_path / "a.bin"

    def full(_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError) as caught, atomic_write(path) as file:
        file.write(b"x")
    assert str(caught.value) == f"{path}: cannot be written: {os.strerror(code).lower()}"
    assert list(tmp_path.iterdir()) == []


def test_a_file_too_large_for_the_disk(tmp_path):
    """A real write error, by a limit on the size of files."""
    old, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, old[1]))
    try:
        with (
            pytest.raises(InputError, match="cannot be written: file too large"),
            atomic_write(tmp_path / "a") as file,
        ):
            file.write(bytes(1 << 20))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_places_that_cannot_be_written(tmp_path):
    put(tmp_path, "file", "folder/a")
    for bad, words in (
        ("none/a", "no such file"),
        ("file/a", "not a directory"),
        ("folder", "is a directory"),
    ):
        with pytest.raises(InputError, match=words) as caught, atomic_write(tmp_path / bad) as file:
            file.write(b"x")
        assert str(caught.value).startswith(f"{tmp_path / bad}: cannot be written")
    with pytest.raises(InputError, match="cannot be written"):
        output_folder(tmp_path / "file" / "deep")
    with pytest.raises(InputError, match="cannot be written"):
        output_folder(tmp_path / "file")
    assert output_folder(tmp_path / "new" / "deep").is_dir()
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a", "deep", "file", "folder", "new"]


def test_a_folder_that_nothing_came_into_goes_again(tmp_path):
    def left(write):
        with contextlib.suppress(RuntimeError), filled_folder(tmp_path / "new" / "deep") as folder:
            if write:
                (folder / "a").touch()
            raise RuntimeError
        return sorted(p.name for p in tmp_path.rglob("*"))

    assert left(write=False) == []
    assert left(write=True) == left(write=False) == ["a", "deep", "new"]


def test_errors_of_other_files_pass_through(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "a"):
        (tmp_path / "other").read_bytes()
    assert list(tmp_path.iterdir()) == []


def test_find_images(tmp_path):
    put(
        tmp_path,
        "b.PNG",
        "a.jpg",
        "c.npy",
        "d.raw.npy",
        "notes.txt",
        ".hidden.png",
        "sub/e.tif",
        ".sub/f.png",
    )
    found = [str(p.relative_to(tmp_path)) for p in find_images(tmp_path)]
    assert found == ["a.jpg", "b.PNG", "c.npy"]
    deep = [str(p.relative_to(tmp_path)) for p in find_images(tmp_path, recursive=True)]
    assert deep == ["a.jpg", "b.PNG", "c.npy", "sub/e.tif"]
    given = [tmp_path / "sub", tmp_path / "b.PNG", tmp_path]
    assert [p.name for p in find_images(given)] == ["e.tif", "b.PNG", "a.jpg", "c.npy"]


def test_find_images_refuses(tmp_path):
    put(tmp_path, "notes.txt")
    (tmp_path / "empty").mkdir()
    for bad, words in (
        (tmp_path, "holds no images"),
        (tmp_path / "empty", "holds no images"),
        (tmp_path / "none.png", "no such file"),
        (tmp_path / "none", "no such file"),
        (tmp_path / "notes.txt", "not an image"),
        ([], "no input files"),
    ):
        with pytest.raises(InputError, match=words):
            find_images(bad)


def test_list_folder_refuses(tmp_path):
    put(tmp_path, "a")
    with pytest.raises(InputError, match="is a file, expected a folder"):
        list_folder(tmp_path / "a")
    with pytest.raises(InputError, match="no such folder"):
        list_folder(tmp_path / "b")


def test_output_folder_says_what_stands_there(tmp_path):
    put(tmp_path, "a")
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("a", "is a file"), ("pipe", "is a FIFO")):
        with pytest.raises(InputError, match=f"{name}: cannot be written: {words}, expected a folder"):
            output_folder(tmp_path / name)


def test_toml(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('a = 1\nb = [2, "x"]\n')
    assert read_toml(path) == {"a": 1, "b": [2, "x"]}
    path.write_text("a = 1\nb = = 2\n")
    with pytest.raises(InputError, match=r"a\.toml: is not valid TOML: .*line 2"):
        read_toml(path)
    path.write_bytes(b"a = '\xff'")
    with pytest.raises(InputError, match="UTF-8"):
        read_toml(path)
    with pytest.raises(InputError, match="no such file"):
        read_toml(tmp_path / "none.toml")


def test_io_imports_no_jax_itself():
    """jaxisp.io works on NumPy arrays: no module of it names jax."""
    for module in Path(jaxisp.io.__file__).parent.glob("*.py"):
        lines = module.read_text().splitlines()
        assert not [line for line in lines if line.split()[:2] in (["import", "jax"], ["from", "jax"])], (
            module
        )


def test_a_killed_writer_leaves_nothing_and_another_is_not_disturbed(tmp_path):
    path = tmp_path / "a.bin"
    (tmp_path / ".a.bin.tmp").write_bytes(b"of somebody else")
    with atomic_write(path) as file:
        file.write(b"one")
        with atomic_write(path) as second:  # as another process would
            second.write(b"two")
        assert path.read_bytes() == b"two"
        file.seek(0)
        file.write(b"ONE")
    killed = """if True:
        import os, signal, sys
        from jaxisp.io.files import atomic_write
        with atomic_write(sys.argv[1]) as file:
            file.write(bytes(1 << 20))
            os.kill(os.getpid(), signal.SIGKILL)"""
    assert subprocess.run([sys.executable, "-c", killed, path]).returncode == -signal.SIGKILL
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {
        "a.bin": b"ONE",
        ".a.bin.tmp": b"of somebody else",
    }


def test_a_file_system_without_unnamed_files(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "O_TMPFILE")
    test_atomic_write(tmp_path)
    (tmp_path / "a.bin").unlink()
    test_nothing_is_left_after_an_error(tmp_path, RuntimeError("stop"))
    monkeypatch.undo()
    monkeypatch.setattr("jaxisp.io.files._numbered", lambda descriptor: "/nowhere")  # no /proc
    (tmp_path / "a.bin").unlink()
    test_atomic_write(tmp_path)


def special_files(folder):
    """What may stand where a file is expected, by name; devices are nodes of this folder."""
    put(folder, "target")
    (folder / "link").symlink_to(folder / "target")
    (folder / "lost link").symlink_to(folder / "nothing")
    os.mkfifo(folder / "FIFO")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(folder / "socket"))
    names = ["link", "lost link", "FIFO", "socket"]
    with contextlib.suppress(PermissionError):
        os.mknod(folder / "zero device", stat.S_IFCHR | 0o666, os.makedev(1, 5))
        os.mknod(folder / "block device", stat.S_IFBLK | 0o666, os.makedev(7, 7))
        names += ["zero device", "block device"]
    return names


def open_to_all(folder):
    """Let any user into a folder of pytest's, and write there."""
    for path in folder.parents:
        if path == Path(tempfile.gettempdir()):
            break
        path.chmod(0o755)
    folder.chmod(0o777)


@contextlib.contextmanager
def as_nobody():
    """Permissions do not stop root."""
    if os.geteuid():
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def special_inputs(folder):
    """Paths that are no file to be read, and what has to be said of each."""
    said = {"link": "", "lost link": "no such file", "socket": "is a socket", "FIFO": "is a FIFO"}
    found = {}
    for name in special_files(folder):
        if what := said.get(name, "is a device"):
            found[folder / name] = what
    put(folder, "closed", "closed folder/a.png")
    (folder / "closed").chmod(0)
    (folder / "closed folder").chmod(0)
    with open(os.fsencode(folder) + b"/\xff\xfe", "wb") as file:
        file.write(b"x")
    return found | {
        folder / "closed": "permission denied",
        folder / "closed folder": "permission denied",
        folder / "closed folder" / "a.png": "permission denied",
        folder / "N\0L": "NUL",
        Path(os.fsdecode(os.fsencode(folder) + b"/\xff\xfe")): "not UTF-8",
        folder / ("n" * 255): "no such file",
        folder / ("n" * 256): "file name too long",
        folder / ("n/" * 3000): "file name too long",
    }


@pytest.mark.parametrize(
    "reader", [check_file, digest_of, read_image, read_jpeg, read_raw, load_npy, read_toml, read_json]
)
def test_special_inputs_are_refused_at_once(tmp_path, reader):
    open_to_all(tmp_path)
    wanted = special_inputs(tmp_path)
    with as_nobody():
        for path, what in wanted.items():
            clock, held = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            with pytest.raises(InputError) as caught:
                reader(path)
            assert time.perf_counter() - clock < 1
            assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held < 50_000
            assert str(caught.value).startswith(f"{path}: ") and what in str(caught.value)


def test_one_bad_input_of_many_does_not_end_the_rest(tmp_path):
    open_to_all(tmp_path)
    (tmp_path / "of").mkdir()
    (tmp_path / "of" / "shut").mkdir()
    os.mkfifo(tmp_path / "of" / "FIFO.png")
    (tmp_path / "of" / "lost.png").symlink_to("nothing")
    put(tmp_path, "of/fine.png")
    (tmp_path / "of" / "shut").chmod(0)
    bad = [*special_inputs(tmp_path), tmp_path / "none.png"]
    with as_nobody():
        found = find_images([*bad, tmp_path / "of"], recursive=True)
        told = {}
        for path in found:
            try:
                check_file(path)
            except InputError as error:
                told[path] = str(error)
        assert [p for p in found if p not in told] == [tmp_path / "of" / "fine.png"]
        assert told.keys() == {*bad, *(tmp_path / "of" / n for n in ("FIFO.png", "lost.png", "shut"))}
        assert told[tmp_path / "of" / "shut"].endswith("shut: cannot be read: permission denied")
        with pytest.raises(InputError, match="cannot be read: permission denied"):
            list_folder(tmp_path / "of" / "shut")


def test_outputs_replace_nothing_but_plain_files(tmp_path):
    for name in special_files(tmp_path):
        path = tmp_path / name
        before = os.lstat(path)
        for attempt in (lambda p: write_text(p, "x"), output_file):
            with pytest.raises(InputError) as caught:
                attempt(path)
            kind = name.rpartition(" ")[2]
            assert str(caught.value) == f"{path}: cannot be written: is a {kind}, which is not replaced"
        assert os.lstat(path) == before and (tmp_path / "target").read_bytes() == b"x"


def test_an_output_with_another_name_leaves_that_one_alone(tmp_path):
    put(tmp_path, "a")
    os.link(tmp_path / "a", tmp_path / "other")
    write_text(tmp_path / "a", "new")
    assert (tmp_path / "other").read_bytes() == b"x"


def test_a_lock_is_no_file_of_others(tmp_path):
    special = special_files(tmp_path)
    put(tmp_path, "text")
    for name in (*special, "text"):
        lock = tmp_path / f"run {name}" / ".lock"
        lock.parent.mkdir()
        os.rename(tmp_path / name, lock)
        before = os.lstat(lock)
        refused = pytest.raises(InputError, match=r"\.lock: is a .*, where a lock has to be; move it away")
        with refused, locked(lock.parent):
            pass
        assert os.lstat(lock) == before and (tmp_path / "target").read_bytes() == b"x"
    (tmp_path / "run" / "of").mkdir(parents=True)
    (tmp_path / "run" / ".lock").touch()  # empty: it may be anybody's, so it is used and stays
    refused = pytest.raises(InputError, match="another process is writing")
    with locked(tmp_path / "run"), locked(tmp_path / "run" / "of"), refused, locked(tmp_path / "run" / "of"):
        pass
    assert [p.name for p in (tmp_path / "run").iterdir()] == [".lock", "of"]
    assert not list((tmp_path / "run" / "of").iterdir())
