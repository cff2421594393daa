"""Public data sets: what they are, under which licence, and fetching them.

Nothing is bundled and nothing is fetched unasked. Each set goes to a folder of its own with SOURCE.json,
which says where its files came from and what their checksums are.
"""

import dataclasses
import json
import os
import shutil
import tarfile
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxisp.errors import InputError
from jaxisp.io.files import output_folder, write_text, writing
from jaxisp.io.locks import locked
from jaxisp.process.cache import user_cache

SWITCH = "JAXISP_DATA"
"""Environment variable: the folder that holds the sets, one folder each, in place of the user's cache."""
SOURCE, SUMS = "SOURCE.json", "checksums.json"
_DAMAGED = (shutil.ReadError, tarfile.TarError, zipfile.BadZipFile, zlib.error, ValueError, EOFError)
Tick = Callable[[int, int, str], Any]


@dataclasses.dataclass(frozen=True)
class RemoteFile:
    """A file to fetch.

    Args:
        url: where it is.
        name: what it is called here.
        digest: "md5:..." or "sha256:..." as its makers or several independent programs state it; None: it is
            written down at the first fetch, and compared at later ones.
        archive: "zip" or "tar" where it is unpacked and then removed.
    """

    url: str
    name: str
    digest: str | None = None
    archive: str | None = None


@dataclasses.dataclass(frozen=True)
class PublicSet:
    """A public data set; without files it is fetched by hand from its page."""

    name: str
    title: str
    use: str
    licence: str
    size: str
    page: str
    files: tuple[RemoteFile, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        table = dataclasses.asdict(self)
        return {**table, "fetched": is_fetched(self.name), "folder": str(data_folder() / self.name)}


_ETH = "https://data.vision.ee.ethz.ch/cvl"
_BERKELEY = "https://www2.eecs.berkeley.edu/Research/Projects/CS/vision"
_POLYU = "https://github.com/csjunxu/PolyU-Real-World-Noisy-Images-Dataset"
_COMMIT = "e08a1f7a025ccf0abd603cb893c55026f772658b"
_AUTHORS = f"https://raw.githubusercontent.com/12dmodel/camera_sim/{_COMMIT}/samples"

SETS = {
    s.name: s
    for s in (
        PublicSet(
            "camera-sim", "Samples of the paper's authors (Jaroensri et al. 2019): an iPhone 7 RAW+JPEG pair",
            "fitting", "none stated", "6 MB", "https://github.com/12dmodel/camera_sim",
            tuple(RemoteFile(f"{_AUTHORS}/{name}", name) for name in ("iphone7_dng.npy", "iphone7_jpg.npy")),
        ),
        PublicSet(
            "kodak", "Kodak lossless true colour image suite: 24 scans of film, 768x512", "clean",
            "released by Kodak for unrestricted use", "15 MB", "https://r0k.us/graphics/kodak/",
            tuple(
                RemoteFile(f"https://r0k.us/graphics/kodak/kodak/kodim{i:02d}.png", f"kodim{i:02d}.png")
                for i in range(1, 25)
            ),
        ),
        PublicSet(
            "clic-2020", "CLIC 2020, professional, validation: 41 photographs, PNG", "clean",
            "Unsplash licence", "130 MB", "https://clic.compression.cc/2020/",
            (RemoteFile(f"{_ETH}/clic/professional_valid_2020.zip", "professional_valid_2020.zip",
                        "md5:7111ee240435911db04dbc5f40d50272", "zip"),),
        ),
        PublicSet(
            "div2k-valid", "DIV2K, validation: 100 photographs of 2K, PNG", "clean", "academic research only",
            "430 MB", "https://data.vision.ee.ethz.ch/cvl/DIV2K/",
            (RemoteFile(f"{_ETH}/DIV2K/DIV2K_valid_HR.zip", "DIV2K_valid_HR.zip", None, "zip"),),
        ),
        PublicSet(
            "bsds300", "Berkeley segmentation data set: 300 JPEGs, 481x321", "clean, compressed once",
            "non-commercial research and education", "22 MB", f"{_BERKELEY}/bsds/",
            (RemoteFile(f"{_BERKELEY}/bsds/BSDS300-images.tgz", "BSDS300-images.tgz", None, "tar"),),
        ),
        PublicSet(
            "sidd-small", "Smartphone image denoising data set, small, sRGB: 160 pairs, rendered from RAW",
            "noise before a phone's own processing", "MIT", "6.6 GB", "https://abdokamel.github.io/sidd/",
            (RemoteFile("http://130.63.97.225/share/SIDD_Small_sRGB_Only.zip", "SIDD_Small_sRGB_Only.zip",
                        "md5:796971867583bf14677dcae510e52538", "zip"),),
        ),
        PublicSet(
            "polyu", "PolyU: 40 scenes, noisy JPEGs of five cameras and means of 500 shots", "evaluation",
            "non-commercial research", "about 1 GB",
            _POLYU,
            (RemoteFile(f"{_POLYU}/archive/refs/heads/master.zip", "master.zip", None, "zip"),),
        ),
        PublicSet(
            "renoir", "RENOIR: 120 scenes in low light, three cameras, with clean references", "evaluation",
            "see its page", "several GB", "https://ani.stat.fsu.edu/~abarbu/Renoir.html",
        ),
        PublicSet(
            "fivek", "MIT-Adobe FiveK: 5000 DNGs with five retouched versions", "RAW files",
            "Adobe's and Adobe/MIT's licences, research only", "50 GB", "https://data.csail.mit.edu/graphics/fivek/",
        ),
    )
}  # fmt: skip
"""Public sets by name, as `jaxisp data list` shows them: what each is for, its licence, and what to fetch."""


def data_folder() -> Path:
    """Where the sets are on this machine."""
    chosen = os.environ.get(SWITCH)
    return Path(chosen).expanduser() if chosen else user_cache() / "data"


def is_fetched(name: str) -> bool:
    """Whether the folder of a set is there with something in it."""
    folder = data_folder() / name
    return folder.is_dir() and any(folder.iterdir())


def find_set(name: str) -> PublicSet:
    """A set by name. Raises InputError that lists what there is."""
    if name not in SETS:
        raise InputError(f"no data set named {name!r}; there are {', '.join(SETS)}")
    return SETS[name]


def fetch(name: str | PublicSet, *, tick: Tick = lambda done, total, text: None) -> Path:
    """The folder of a data set, downloaded unless it is there.

    A download that was interrupted goes on where it stopped. Files with a known checksum are checked; of
    the others it is written down, and compared when they are fetched again.

    Args:
        name: of a set in `SETS`.
        tick: called with (bytes done, bytes in all, file name).

    Raises:
        InputError: no such set, no network, no room, or a file is not the one it should be.
    """
    wanted = find_set(name) if isinstance(name, str) else name
    root, folder = data_folder(), data_folder() / wanted.name
    if is_fetched(wanted.name):
        return folder
    if not wanted.files:
        raise InputError(
            f"{wanted.name}: no program can fetch it; get it from {wanted.page} and put it into {folder}"
        )
    partial = root / f".{wanted.name}.partial"
    with locked(root, name=f".{wanted.name}.lock"):
        if is_fetched(wanted.name):  # by another process meanwhile
            return folder
        with writing(folder):
            found = [_fetch_file(wanted, file, output_folder(partial), tick) for file in wanted.files]
            for file in wanted.files:
                _unpack(partial / file.name, file.archive)
            for file in wanted.files:  # not before: what kills an unpacking should not cost the download
                if file.archive:
                    (partial / file.name).unlink()
            _note(root / SUMS, {f["url"]: f"sha256:{f['sha256']}" for f in found} | _sums(root))
            about = {**dataclasses.asdict(wanted), "files": found, "fetched": time.strftime("%F")}
            _note(partial / SOURCE, about)
            shutil.rmtree(folder, ignore_errors=True)  # it is empty
            partial.replace(folder)
    return folder


def _fetch_file(wanted: PublicSet, file: RemoteFile, partial: Path, tick: Tick) -> dict[str, Any]:
    from jaxisp.data.download import digest_of, download

    expected = file.digest or _sums(partial.parent).get(file.url)
    try:
        path = download(file.url, partial / file.name, expected, tick)
    except ConnectionError as error:
        raise InputError(
            f"{wanted.name}: {file.url} cannot be fetched ({error}); run this again to go on, or, without a "
            f"network, put the files of {wanted.page} into {partial.parent / wanted.name}"
        ) from error
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"{wanted.name}: {file.url} is not the file that it was: {expected} was expected. If it has "
            f"changed for a good reason, remove it from {partial.parent / SUMS}"
        ) from error
    about = {"url": file.url, "name": file.name, "bytes": path.stat().st_size}
    return {**about, "sha256": digest_of(path, "sha256"), "checked_against": expected}


def _unpack(path: Path, archive: str | None) -> None:
    """Unpack beside itself; names that lead elsewhere are left out or refused."""
    if archive is None:
        return
    try:
        if archive == "tar":
            shutil.unpack_archive(path, path.parent, filter="data")
        else:
            shutil.unpack_archive(path, path.parent, "zip")
    except _DAMAGED as error:
        path.unlink()  # so that it is fetched again
        raise InputError(f"{path}: is a damaged archive ({error})") from error


def _sums(root: Path) -> dict[str, str]:
    """Checksums of files fetched before, by URL."""
    try:
        table = json.loads((root / SUMS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {k: v for k, v in table.items() if isinstance(v, str)} if isinstance(table, dict) else {}


def _note(path: Path, table: dict[str, Any]) -> None:
    write_text(path, json.dumps(table, indent=1) + "\n")
