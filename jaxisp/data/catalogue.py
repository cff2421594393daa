"""Public data sets: what they are, under which licence, and fetching them.

Nothing is bundled and nothing is fetched unasked. Each set goes to a folder of its own with SOURCE.json,
which says where its files came from and what their checksums are.
"""

import dataclasses
import json
import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxisp.data.download import check_own, digest_of, download
from jaxisp.data.unpack import unpack
from jaxisp.errors import InputError, short
from jaxisp.io.digests import is_sealed, sealed_json
from jaxisp.io.files import files_below, kind_of, output_folder, parse_json, read_text, write_text, writing
from jaxisp.io.locks import locked
from jaxisp.process.cache import user_cache

SWITCH = "JAXISP_DATA"
"""Environment variable: the folder that holds the sets, one folder each, in place of the user's cache."""
SOURCE, SUMS = "SOURCE.json", "checksums.json"
_DIGEST = re.compile("md5:[0-9a-f]{32}|sha256:[0-9a-f]{64}")
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
        place = {"fetched": is_fetched(self.name), "folder": str(data_folder() / self.name)}
        return {**dataclasses.asdict(self), "unpinned": list(self.unpinned), **place}

    @property
    def unpinned(self) -> tuple[str, ...]:
        """The files of which no checksum is published: the first that comes is trusted."""
        return tuple(file.name for file in self.files if file.digest is None)


_ETH = "https://data.vision.ee.ethz.ch/cvl"
_BERKELEY = "https://www2.eecs.berkeley.edu/Research/Projects/CS/vision"
_POLYU = "https://github.com/csjunxu/PolyU-Real-World-Noisy-Images-Dataset"
_COMMIT = "e08a1f7a025ccf0abd603cb893c55026f772658b"
_R0K = "https://r0k.us/graphics/kodak"
_AUTHORS = f"https://raw.githubusercontent.com/12dmodel/camera_sim/{_COMMIT}/samples"

_KODAK = (
    "a56e27cbf5f843c048b6af1d6e090760e9c92fadba88b7dee0205918a37523bd",
    "4f4b74a79237e311d72cad958237b5f7088d8bce1c82305ebefe1a70e3022dfd",
    "e25ca1ff2f0c0cb5fdfd5f9b0a0bb21ac4c3de3c84a67f35b09a85d3306249db",
    "e3b946107c5d3441c022f678d0c3caf1e224d81b1604ba840a4f88e562de61aa",
    "10349e963c5c813d327852f82c1795fa4148d69fedffc4c589bee458e3ac3d53",
    "363510303b715d4cbc384e1ce227e466b613a09e1b71ae985882bf8e7fbd9b18",
    "b77d3f006f42414bb242222e0482e750c0fb9e5ee8d4bed2f6f11c5605fe54a4",
    "ba23983c76b4832ee0e8af0592664756841a16779acd69f792e268fb6d13d6e7",
    "6a4361c2fc194feb4edaa9f9a4a0620fb9943e460ac7fdf037fb0f6dd6607a7d",
    "9dfb70f5867c29ff9ed6313683f19b3d867849e40fbc0c4c54a4a89df341cf23",
    "7936814b58b5387fce2e4e2488b4ec830dadd95fa9520f358ddb30990b50f2b6",
    "d78c37c2f04f23761ed2367dd77e2db584ddd4c3950833fecf89f199a8126980",
    "bc34a3ce58dea09dce1704c997171602de90cb34d0c8503a988b77f473d39b08",
    "55a94550ff18f3246c4074fd32b77b0c74447c26b6ad274d564d999c0450ba6e",
    "7538cbb80cb9103606c48b806eae57d56c885c7f90b9b3be70a41160f9cbb683",
    "a89c7268ccd4718ba424a99fc4643c572cf692ca6eae887185ceb4e9f11d2e54",
    "37afcc89fbdcb76d9518e04b2fc011027e2f4cd14b3b2f83cefd721641a47c5b",
    "1a9258c365988961d87a0598725b609139c303ad48a5aad6c503c3b1a87849aa",
    "b7450b264b1b0a411390d8931b112c27905a992520fc90569dc4b920aa32bbdc",
    "3b46c71e3b92a563820ba32936be8330c586c41f938efd94be938386aae4328a",
    "ac958597c82073f6bb65129c68f72b651db5b9efd82e11547d07350214bc268b",
    "1cee58eb1f2d9c7ebb254d208a03c783ce6cf2c4d8c2cf45e235dd23b4ce1b29",
    "e3111a2fd4da24af15d6459ef9eacfe54106b38e27b4a21821b75c3f5d2d5baf",
    "1071c68372cc5a01435c2c225a5cf7d4bb803846ec08bb6b3d6721b156d7cb96",
)
"""SHA-256 of the 24 pictures, as several programs that fetch them state it."""

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
            "released by Kodak for unrestricted use", "15 MB", f"{_R0K}/",
            tuple(
                RemoteFile(f"{_R0K}/kodak/kodim{i:02d}.png", f"kodim{i:02d}.png", f"sha256:{digest}")
                for i, digest in enumerate(_KODAK, 1)
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
            (RemoteFile(f"{_ETH}/DIV2K/DIV2K_valid_HR.zip", "DIV2K_valid_HR.zip",
                        "sha256:20dd31fd84d777bc1cf5d6b7654a3f569c0aec74458ae094122ad1d0489900fc", "zip"),),
        ),
        PublicSet(
            "bsds300", "Berkeley segmentation data set: 300 JPEGs, 481x321", "clean, compressed once",
            "non-commercial research and education", "22 MB", f"{_BERKELEY}/bsds/",
            (RemoteFile(f"{_BERKELEY}/grouping/segbench/BSDS300-images.tgz", "BSDS300-images.tgz",
                        "sha256:a5f7d0e49fe135c75518a3543ced24470156fd69305ae77845dff2a5138652b4", "tar"),),
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
    """Where the sets are on this machine. InputError where no place is named and the user has no home."""
    if chosen := os.environ.get(SWITCH):
        try:
            return Path(chosen).expanduser()
        except RuntimeError as error:
            raise InputError(f"{SWITCH}={chosen}: there is no such home") from error
    if cache := user_cache():
        return cache / "data"
    raise InputError(f"there is no home folder to keep data sets in: set {SWITCH} to a folder")


def is_fetched(name: str) -> bool:
    """Whether the folder of a set is there with something in it."""
    try:
        return any((data_folder() / name).iterdir())
    except OSError:
        return False


def find_set(name: str) -> PublicSet:
    """A set by name. Raises InputError that lists what there is."""
    if name not in SETS:
        raise InputError(f"no data set named {name!r}; there are {', '.join(SETS)}")
    return SETS[name]


def fetch(name: str | PublicSet, *, tick: Tick = lambda done, total, text: None) -> Path:
    """The folder of a data set, downloaded unless it is there.

    A download that was interrupted goes on where it stopped. Files with a known checksum are checked; of
    the others (`PublicSet.unpinned`) it is written down, and compared when they are fetched again.

    Args:
        name: of a set in `SETS`.
        tick: called with (bytes done, bytes in all, file name).

    Raises:
        InputError: no such set, no network, no room, a file is not the one it should be, or something else
            stands where the set, or what has come of it, has to be.
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
    with locked(root, name=f".{wanted.name}.lock", doing="fetching"):
        if is_fetched(wanted.name):  # by another process meanwhile
            return folder
        _check_place(folder)
        _check_place(partial)
        for path in files_below(partial):  # before any of it is read, or the first of a set is fetched
            check_own(path)
        sums = read_sums(root)
        with writing(folder):
            found = [
                _fetch_file(wanted, f, output_folder(partial), sums.get(f.url), tick) for f in wanted.files
            ]
            for file in wanted.files:
                _unpack(partial / file.name, file.archive, {SOURCE, *(f.name for f in wanted.files)})
            for file in wanted.files:  # not before: what kills an unpacking should not cost the download
                if file.archive:
                    (partial / file.name).unlink()
            with locked(root, name=f".{SUMS}.lock", wait=True):  # another may fetch another set
                sums = {f["url"]: f"sha256:{f['sha256']}" for f in found} | read_sums(root)
                write_text(root / SUMS, sealed_json(_table(sums)))
            about = {**dataclasses.asdict(wanted), "files": found, "fetched": time.strftime("%F")}
            write_text(partial / SOURCE, _table(about))
            if os.path.lexists(folder):
                folder.rmdir()  # it is empty
            partial.replace(folder)
    return folder


def _check_place(folder: Path) -> None:
    """Raise InputError where something else than a folder stands: no link is followed, or replaced."""
    if os.path.lexists(folder) and (kind := kind_of(os.lstat(folder).st_mode)) != "a folder":
        raise InputError(f"{folder}: is {kind or 'a file'}, where a folder has to be; move it away")


def _fetch_file(
    wanted: PublicSet, file: RemoteFile, partial: Path, before: str | None, tick: Tick
) -> dict[str, Any]:
    expected = file.digest or before
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
            f"changed for a good reason, remove its entry, "
            f'and the entry "digest", from {partial.parent / SUMS}'
        ) from error
    about = {"url": file.url, "name": file.name, "bytes": path.stat().st_size}
    return {**about, "sha256": digest_of(path, "sha256"), "checked_against": expected}


def _unpack(path: Path, archive: str | None, taken: set[str]) -> None:
    """Unpack beside itself, but nothing that has one of the names that are taken there.

    Where something is wrong with it, it is removed, so that it is fetched again.
    """
    if archive is None:
        return
    unpacked = path.with_name(f".{path.name}.unpacked")
    shutil.rmtree(unpacked, ignore_errors=True)  # of a call that was killed
    try:
        unpack(path, archive, unpacked)
        if both := taken & set(os.listdir(unpacked)):
            raise InputError(f"{path}: holds {min(both)}, in whose place another file of the set has to be")
        for found in unpacked.iterdir():
            place = path.with_name(found.name)
            if place.is_dir():
                shutil.rmtree(place)  # of a call that was killed
            found.replace(place)
        unpacked.rmdir()
    except InputError:
        path.unlink()
        raise
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)


def read_sums(root: Path) -> dict[str, str]:
    """Checksums of files fetched before, by URL.

    They hold their own digest. A table without one, of a version before or changed by hand, is read too: it
    is what was trusted once. The next set that is fetched adds the digest.

    Raises:
        InputError: they are damaged, or another program's: what was trusted once has to stay so.
    """
    path = root / SUMS
    check_own(path)
    text = read_text(path) if os.path.lexists(path) else "{}"
    table = parse_json(text, str(path))
    if "digest" in table and not is_sealed(text):
        raise InputError(
            f"{path}: is not what was written, by its digest; it is damaged, or was changed. Remove the "
            'entry "digest" to use it as it is'
        )
    table.pop("digest", None)
    for url, digest in table.items():
        if "://" not in url or not isinstance(digest, str) or not _DIGEST.fullmatch(digest):
            raise InputError(
                f"{path}: {short(url)} has {short(digest)}, expected a URL with md5: or sha256: and digits; "
                "it is damaged, or another program's"
            )
    return table


def _table(entries: dict[str, Any]) -> str:
    return json.dumps(entries, indent=1) + "\n"
