"""Public data sets: a local server that breaks off, checksums, archives, a stand-in folder, no network."""

import hashlib
import http.server
import io
import json
import os
import re
import socket
import tarfile
import threading
import warnings
import zipfile
from collections.abc import Callable
from typing import ClassVar

import pytest

from jaxisp.cli import main
from jaxisp.data import unpack as unpacking
from jaxisp.data.catalogue import SETS, SUMS, PublicSet, RemoteFile, fetch, find_set, read_sums
from jaxisp.data.unpack import unpack
from jaxisp.errors import InputError
from jaxisp.io.digests import read_sealed
from jaxisp.io.locks import locked

pytest.importorskip("pooch")
DATA = bytes(range(256)) * 4000
SHA = f"sha256:{hashlib.sha256(DATA).hexdigest()}"


class Server(http.server.BaseHTTPRequestHandler):
    """Serves `files`; breaks off after `most` bytes of an answer; notes the ranges it was asked for, and does
    what may be done meanwhile."""

    files: ClassVar[dict[str, bytes]] = {}
    most = len(DATA)
    asked: ClassVar[list[str | None]] = []
    tag = '"one"'
    meanwhile: ClassVar[list[Callable[[], None]]] = []

    def do_GET(self):
        data, wanted = self.files.get(self.path), self.headers.get("Range")
        self.asked.append(wanted)
        while self.meanwhile:
            self.meanwhile.pop()()
        if data is None:
            self.send_error(404)
            return
        same = self.headers.get("If-Range") in (None, self.tag)
        first = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted and same else 0
        if first >= len(data):
            self.send_error(416)
            return
        self.send_response(206 if first else 200)
        self.send_header("ETag", self.tag)
        self.send_header("Content-Length", str(len(data) - first))
        self.end_headers()
        self.wfile.write(data[first : first + self.most])

    def log_message(self, *_):
        pass


@pytest.fixture
def server(monkeypatch, tmp_path):
    monkeypatch.setenv("JAXISP_DATA", str(tmp_path / "data é"))
    for name in ("http_proxy", "HTTP_PROXY", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    Server.files, Server.most, Server.asked, Server.tag = {"/a.bin": DATA}, len(DATA), [], '"one"'
    Server.meanwhile = []
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def public(*files: RemoteFile) -> PublicSet:
    return PublicSet("small", "A small set", "tests", "CC0", "1 MB", "https://example.org", files)


def test_an_interrupted_download_goes_on_where_it_stopped(server, tmp_path):
    wanted = public(RemoteFile(f"{server}/a.bin", "a.bin", SHA))
    Server.most = 300_000
    for _ in range(3):
        with pytest.raises(InputError, match=r"small: .*a\.bin cannot be fetched .*run this again to go on"):
            fetch(wanted)
    assert not (tmp_path / "data é" / "small").exists()
    Server.most = len(DATA)
    folder = fetch(wanted)
    assert Server.asked == [None, "bytes=262144-", "bytes=524288-", "bytes=786432-"]
    assert (folder / "a.bin").read_bytes() == DATA and sorted(p.name for p in folder.iterdir()) == [
        "SOURCE.json",
        "a.bin",
    ]
    source = json.loads((folder / "SOURCE.json").read_text())
    assert source["licence"] == "CC0" and f"sha256:{source['files'][0]['sha256']}" == SHA
    assert fetch(wanted) == folder and len(Server.asked) == 4


def test_a_file_that_changed_meanwhile_is_fetched_from_its_start(server):
    wanted = public(RemoteFile(f"{server}/a.bin", "a.bin"))
    Server.most = 200_000
    with pytest.raises(InputError):
        fetch(wanted)
    Server.files, Server.most, Server.tag = {"/a.bin": b"another file"}, len(DATA), '"two"'
    assert (fetch(wanted) / "a.bin").read_bytes() == b"another file"
    Server.files = {"/b.bin": DATA[:5]}


@pytest.mark.parametrize("name", [".a.bin.part", ".a.bin.etag", "a.bin"])
def test_a_folder_in_the_place_of_a_download_is_refused(server, tmp_path, name):
    (tmp_path / "data é" / ".small.partial" / name).mkdir(parents=True)
    with pytest.raises(InputError, match=rf"{name}: is a folder, where a file of our own has to be"):
        fetch(public(RemoteFile(f"{server}/a.bin", "a.bin")))
    assert Server.asked == []


@pytest.mark.parametrize("broken", [False, True])
@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_a_link_that_comes_meanwhile_is_not_written_through(server, tmp_path, broken, link):
    wanted, mine = public(RemoteFile(f"{server}/a.bin", "a.bin", SHA)), tmp_path / "mine"
    part = tmp_path / "data é" / ".small.partial" / ".a.bin.part"
    mine.write_bytes(b"mine")
    if broken:
        Server.most = 300_000
        with pytest.raises(InputError, match="run this again to go on"):
            fetch(wanted)
        Server.most = len(DATA)
    Server.meanwhile.append(lambda: (part.unlink(missing_ok=True), link(mine, part)))
    if broken:
        with pytest.raises(InputError, match=r"\.a\.bin\.part: is a (hard )?link"):
            fetch(wanted)
        part.unlink()
    assert (fetch(wanted) / "a.bin").read_bytes() == DATA
    assert mine.read_bytes() == b"mine" and Server.meanwhile == []


@pytest.mark.parametrize(
    "mark", ["", "[" * 100_000, "\udcff", '"' + "x" * (17 << 20)], ids=["empty", "deep", "no text", "large"]
)
def test_a_damaged_note_of_a_download_is_as_good_as_none(server, tmp_path, mark):
    wanted = public(RemoteFile(f"{server}/a.bin", "a.bin", SHA))
    Server.most = 300_000
    with pytest.raises(InputError, match="run this again to go on"):
        fetch(wanted)
    note = tmp_path / "data é" / ".small.partial" / ".a.bin.etag"
    note.write_bytes(mark.encode(errors="surrogateescape"))
    Server.most = len(DATA)
    assert (fetch(wanted) / "a.bin").read_bytes() == DATA and Server.asked[1] is not None


def test_a_wrong_file_is_refused_and_a_recorded_checksum_is_compared(server, tmp_path):
    with pytest.raises(InputError, match="is not the file that it was: sha256:0000"):
        fetch(public(RemoteFile(f"{server}/a.bin", "a.bin", "sha256:" + "0" * 64)))
    wanted, root = public(RemoteFile(f"{server}/a.bin", "a.bin")), tmp_path / "data é"
    folder = fetch(wanted)
    assert read_sums(root) == {f"{server}/a.bin": SHA}
    for path in folder.iterdir():
        path.unlink()
    Server.files = {"/a.bin": DATA[:-1] + b"x"}
    with pytest.raises(InputError, match="is not the file that it was"):
        fetch(wanted)


def test_a_file_without_a_checksum_is_told_and_trusted_once(server, monkeypatch, capsys):
    monkeypatch.setitem(SETS, "kodak", public(RemoteFile(f"{server}/a.bin", "a.bin")))
    for again, lines in ((False, 2), (True, 1)):
        assert main(["data", "fetch", "kodak"]) == 0
        told = capsys.readouterr().err.splitlines()
        assert len(told) == lines and ("no checksum is published of a.bin" in told[-1]) != again
    monkeypatch.setitem(SETS, "kodak", public(RemoteFile(f"{server}/a.bin", "a.bin", SHA)))
    assert main(["data", "list"]) == 0
    listed = capsys.readouterr().out
    assert listed.count("no checksum is published") == 2  # camera-sim, polyu


@pytest.mark.parametrize(
    "damage",
    [
        {"https://a/b": 5},
        {"https://a/b": [SHA]},
        {"https://a/b": None},
        {"https://a/b": "crc:1"},
        {"a": SHA},
        {"https://a/b": SHA[:-1]},
    ],
)
def test_noted_checksums_that_are_none_are_one_error(server, tmp_path, damage):
    """What was trusted once is not forgotten because it cannot be read."""
    root = tmp_path / "data é"
    root.mkdir()
    (root / SUMS).write_text(json.dumps(damage))
    with pytest.raises(
        InputError, match=r"checksums\.json: .* expected a URL with md5: or sha256:"
    ) as caught:
        fetch(public(RemoteFile(f"{server}/a.bin", "a.bin", SHA)))
    assert "\n" not in str(caught.value) and Server.asked == []
    assert json.loads((root / SUMS).read_text()) == damage and os.listdir(root) == [SUMS]


def test_no_flipped_bit_of_noted_checksums_is_accepted(server, tmp_path):
    """An entry that is lost would let another file be trusted."""
    root = tmp_path / "data é"
    fetch(public(RemoteFile(f"{server}/a.bin", "a.bin")))
    sums = (root / SUMS).read_bytes()

    def refused(data: bytes) -> bool:
        (root / SUMS).write_bytes(data)
        try:
            read_sums(root)
        except InputError as error:
            return "checksums.json: " in str(error)
        return False

    for place in range(0, 8 * len(sums), 3):
        flipped = bytearray(sums)
        flipped[place // 8] ^= 1 << place % 8
        assert refused(flipped), place
    assert all(refused(sums[:length]) for length in range(0, len(sums) - 1, 5))


def test_checksums_of_a_version_before_are_kept_and_sealed(server, tmp_path):
    """They, and those that were changed as the error for another file says, do not hold their digest."""
    root = tmp_path / "data é"
    root.mkdir()
    (root / SUMS).write_text(json.dumps({f"{server}/a.bin": SHA, "https://a/b": SHA}))
    Server.files = {"/a.bin": b"another"}
    with pytest.raises(InputError, match=r"is not the file that it was.*remove its entry, and the entry"):
        fetch(public(RemoteFile(f"{server}/a.bin", "a.bin")))
    Server.files = {"/a.bin": DATA}
    fetch(public(RemoteFile(f"{server}/a.bin", "a.bin")))
    assert read_sums(root) == {f"{server}/a.bin": SHA, "https://a/b": SHA}
    text = read_sealed(root / SUMS)
    (root / SUMS).write_text(text.replace("https://a/b", "https://a/c"))
    with pytest.raises(InputError, match=r"is not what was written.*Remove the entry"):
        read_sums(root)
    (root / SUMS).write_text(re.sub('"digest": "[^"]*",', "", text))
    assert read_sums(root)["https://a/b"] == SHA


def test_two_that_fetch_the_same(server, tmp_path):
    with (
        locked(tmp_path / "data é", name=".small.lock"),
        pytest.raises(InputError, match="another process is fetching into this folder"),
    ):
        fetch(public(RemoteFile(f"{server}/a.bin", "a.bin", SHA)))
    assert Server.asked == []


def zipped(*members, **options):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", **options) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that come twice
        for name, data in members:
            info = zipfile.ZipInfo(name) if isinstance(name, str) else name
            info.compress_type = file.compression
            file.writestr(info, data)
    return out.getvalue()


def tarred(*members, mode="w:gz", **options):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode=mode, **options) as file:
        for name, data, *more in members:
            member = tarfile.TarInfo(name)
            member.size = len(data)
            for key, value in dict(*more).items():
                setattr(member, key, value)
            file.addfile(member, io.BytesIO(data))
    return out.getvalue()


def long_way_out():
    """CVE-2025-4517: links to folders whose whole path is longer than the system takes are not resolved."""
    deep, members, place = "d" * 247, [], ""
    for letter in "abcdefghijklmnop":
        members += [
            (place + deep, b"", {"type": tarfile.DIRTYPE}),
            (place + letter, b"", {"type": tarfile.SYMTYPE, "linkname": deep}),
        ]
        place += deep + "/"
    link = "/".join("abcdefghijklmnop") + "/" + "l" * 254
    members += [
        (link, b"", {"type": tarfile.SYMTYPE, "linkname": "../" * 16}),
        ("escape", b"", {"type": tarfile.SYMTYPE, "linkname": link + "/../../outside"}),
        ("escape/outside.txt", b"out"),
    ]
    return tarred(*members)


LINK = zipfile.ZipInfo("link")
LINK.external_attr = 0o120777 << 16
HOSTILE = {
    "up.zip": zipped(("a.txt", "a"), ("../outside.txt", "out")),
    "only up.zip": zipped(("../../outside.txt", "out")),
    "folder up.zip": zipped(("../outside.txt/", "")),
    "root.zip": zipped(("/tmp/outside.txt", "out")),
    "backslash.zip": zipped(("..\\outside.txt", "out")),
    "drive.zip": zipped(("C:outside.txt", "out")),
    "link.zip": zipped((LINK, "../outside.txt"), ("link/a", "out")),
    "twice.zip": zipped(("a", "one"), ("a", "two")),
    "file and folder.zip": zipped(("a", "one"), ("a/b", "two")),
    "long.zip": zipped(("a/" * 2000 + "outside.txt", "out")),
    "escapes.zip": zipped(("a\x1b[2J.txt", "out")),
    "bomb.zip": zipped(("a", bytes(100 << 20)), compression=zipfile.ZIP_DEFLATED),
    "no archive.zip": b"PK no archive",
    "cut.zip": zipped(("a", "one"))[:-9],
    "NUL.zip": zipped(("a.txt_.png", "a")).replace(b"a.txt_", b"a.txt\0"),
    "empty name.zip": zipped(("", "one")),
    "up.tar": tarred(("b.txt", b"b"), ("../outside.txt", b"b")),
    "root.tar": tarred(("/tmp/outside.txt", b"b")),
    "link.tar": tarred(("l", b"", {"type": tarfile.SYMTYPE, "linkname": ".."}), ("l/outside.txt", b"b")),
    "hard link.tar": tarred(("l", b"", {"type": tarfile.LNKTYPE, "linkname": "../../outside.txt"})),
    "device.tar": tarred(("null", b"", {"type": tarfile.CHRTYPE, "devmajor": 1, "devminor": 3})),
    "FIFO.tar": tarred(("f", b"", {"type": tarfile.FIFOTYPE})),
    "long way.tar": long_way_out(),
    "bomb.tar": tarred(("a", bytes(100 << 20))),
    "no archive.tar": b"\x1f\x8b no archive",
    "cut.tar": tarred(("a", bytes(range(256)) * 99))[:-40],
    "without its checksum.tar": tarred(("a", b"one"))[:-6],
    "another checksum.tar": tarred(("a", b"one"))[:-8] + bytes(8),
    "cut xz.tar": tarred(("a", b"one"), mode="w:xz")[:-20],
    "cut bz2.tar": tarred(("a", b"one"), mode="w:bz2")[:-4],
    "cut after a file.tar": tarred(("a", b"one"), ("b", b"two"), mode="w")[:1024],
    "damaged header.tar": tarred(("a", b"one"), ("bbbb", b"two"), mode="w").replace(b"bbbb", b"bbbc"),
    "header.tar": tarred(("a", b"", {"pax_headers": {"comment": "x" * (1 << 20)}})),
    "shared header.tar": tarred(("a", b"one"), pax_headers={str(i): "" for i in range(101)}),
    "name.tar": tarred(("a" * 20_000, b"one"), format=tarfile.GNU_FORMAT),
    "its own name.zip": zipped(("a", "one"), ("its_own_name.zip", "two")),
    "the note.tar": tarred(("a", b"one"), ("SOURCE.json", b"two")),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_archives_are_refused_whole_and_not_kept(server, tmp_path, name):
    address = name.replace(" ", "_")
    Server.files, Server.most = {f"/{address}": HOSTILE[name]}, 1 << 30
    wanted = public(RemoteFile(f"{server}/{address}", address, archive=name[-3:]))
    with pytest.raises(InputError) as caught:
        fetch(wanted)
    assert str(caught.value).count("\n") == 0 and f"{address}: " in str(caught.value)
    left = [p.name for p in (tmp_path / "data é").rglob("*") if p.name[0] != "."]
    assert left == [] and not list(tmp_path.rglob("outside*")) and not os.path.lexists("/tmp/outside.txt")
    Server.files = {f"/{address}": (zipped if name.endswith("zip") else tarred)(("fine/a.txt", b"a"))}
    assert (fetch(wanted) / "fine" / "a.txt").read_text() == "a"  # fetched again, not the one that failed


@pytest.mark.parametrize("name", ["folders.zip", "folders.tar", "deep.zip", "deep.tar", "files.zip"])
def test_all_that_an_archive_makes_is_counted(tmp_path, monkeypatch, name):
    """Folders too, and those of a file's name."""
    monkeypatch.setattr(unpacking, "MOST_FILES", 100)
    folder = "" if name.endswith("zip") else {"type": tarfile.DIRTYPE}
    members = {
        "folders": [(f"{i}/", b"", *([folder] if folder else [])) for i in range(101)],
        "deep": [("d/" * 60 + "a", b""), ("e/" * 39 + "b", b"")],
        "files": [(str(i), b"") for i in range(101)],
    }[name[:-4]]
    make, path = (tarred if folder else zipped), tmp_path / name
    path.write_bytes(make(*members))
    told = "its list has more than 100" if name in ("files.zip", "folders.zip") else "holds more than 100"
    with pytest.raises(InputError, match=f"{told} files and folders"):
        unpack(path, name[-3:], tmp_path / "out")
    path.write_bytes(make(*members[:-1]))
    unpack(path, name[-3:], tmp_path / "fits")


@pytest.mark.parametrize(
    ("kind", "limit", "most", "told"),
    [
        ("tar", "_FREE", 0, "unpacks to more than 4 times its size"),  # of headers alone
        ("zip", "_MOST_LIST", 1000, "its list of files takes"),  # and is not read
    ],
)
def test_what_stands_beside_the_files_is_bounded_too(tmp_path, monkeypatch, kind, limit, most, told):
    monkeypatch.setattr(unpacking, limit, most)
    path = tmp_path / f"a.{kind}"
    path.write_bytes({"tar": tarred, "zip": zipped}[kind](*[(f"{i}", b"") for i in range(200)]))
    with pytest.raises(InputError, match=told):
        unpack(path, kind, tmp_path / "out")


@pytest.mark.parametrize("mode", ["w", "w:gz", "w:bz2", "w:xz"])
@pytest.mark.parametrize("form", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_each_kind_of_tar_is_unpacked(tmp_path, mode, form):
    names = ["a" * 90, "b", "d/" * 30 + "c"] + ["é/" * 100 + "long"] * (form != tarfile.USTAR_FORMAT)
    path = tmp_path / "a.tar"
    path.write_bytes(tarred(*[(name, name.encode() * 50) for name in names], mode=mode, format=form))
    unpack(path, "tar", tmp_path / "out")
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == name.encode() * 50


@pytest.mark.parametrize("kind", ["zip", "tar"])
def test_archives_are_unpacked(server, kind):
    members = [("./inner/a.txt", b"a"), ("b.txt", b"b"), ("inner/deep/c.txt", bytes(1 << 10))]
    Server.files = {f"/x.{kind}": (zipped if kind == "zip" else tarred)(*members)}
    folder = fetch(public(RemoteFile(f"{server}/x.{kind}", f"x.{kind}", archive=kind)))
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert found == {"inner/a.txt", "b.txt", "inner/deep/c.txt", "SOURCE.json"}
    assert (folder / "inner" / "a.txt").read_text() == "a"


def test_a_folder_stands_in_for_the_download(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAXISP_DATA", str(tmp_path))
    (tmp_path / "kodak").mkdir()
    (tmp_path / "kodak" / "kodim01.png").write_bytes(b"x")
    assert main(["data", "fetch", "kodak", "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["folder"] == str(tmp_path / "kodak") and "unrestricted use" in shown.err
    assert main(["data", "list", "--json"]) == 0
    listed = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert listed["kodak"]["fetched"] and not listed["polyu"]["fetched"] and set(listed) == set(SETS)
    assert main(["data", "list"]) == 0 and "Unsplash licence" in capsys.readouterr().out


def test_without_a_network_one_line_says_what_to_do(tmp_path, monkeypatch, capsys):
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{closed.getsockname()[1]}/a"
    monkeypatch.setenv("JAXISP_DATA", str(tmp_path))
    monkeypatch.setitem(SETS, "kodak", public(RemoteFile(url, "a")))
    assert main(["data", "fetch", "kodak"]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert (
        "cannot be fetched" in last and f"put the files of https://example.org into {tmp_path}/small" in last
    )
    assert main(["data", "fetch", "renoir"]) == 2 and "get it from https://ani" in capsys.readouterr().err
    with pytest.raises(InputError, match="no data set named 'x'; there are camera-sim, kodak"):
        find_set("x")


def test_the_sets_say_where_they_are_from():
    for wanted in SETS.values():
        assert wanted.licence and wanted.page.startswith("https://") and wanted.title
        for file in wanted.files:
            assert file.url.startswith(("https://", "http://")) and file.archive in (None, "zip", "tar")
            kind, _, digits = (file.digest or ":").partition(":")
            assert len(digits) == {"md5": 32, "sha256": 64, "": 0}[kind]
            assert digits or wanted.name in ("camera-sim", "polyu")  # none is published: docs/limits.md
