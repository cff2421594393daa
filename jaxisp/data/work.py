"""Samples: the versions of clean photographs that a recipe makes, each with its pictures and parameters."""

import dataclasses
import functools
import hashlib
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxisp.arrays.extents import Size
from jaxisp.checks import check_seed, check_whole
from jaxisp.errors import InputError
from jaxisp.frames import MOST_FRAMES, Frames, shared_frames
from jaxisp.io.digests import digest_of
from jaxisp.io.files import MOST_NAME, file_state, find_images, real_paths
from jaxisp.io.images import read_image, size_of
from jaxisp.mixture import Degradation, Mixture, check_runs
from jaxisp.process.memory import Programs
from jaxisp.recipe import Recipe, check_levels
from jaxisp.recipes import RecipeLike, find_degradation, recipe_files
from jaxisp.stages.draws import by_index

BATCH_PIXELS = 2_000_000
"""Pixels that go to the device at once; bounds the memory of a run."""
WAITING_PIXELS = 4 * BATCH_PIXELS
"""Pixels that wait for others of their size, or of their frame."""
MOST_SIZED = 2000
"""Pictures whose sizes frames are made for; others go where they fit."""

Tick = Callable[[int, int], Any]


@dataclasses.dataclass
class Outcome:
    """What a run did, and the inputs that it could not use; `kept` were there already."""

    images: int = 0
    seconds: float = 0.0
    kept: int = 0
    failed: list[tuple[str, str]] = dataclasses.field(default_factory=list)

    @property
    def images_per_second(self) -> float:
        return self.images / max(self.seconds, 1e-9)

    def as_dict(self) -> dict[str, Any]:
        return {
            "images": self.images,
            "images_per_second": round(self.images_per_second, 3),
            "seconds": round(self.seconds, 3),
            "kept": self.kept,
            "failed": [{"file": name, "reason": reason} for name, reason in self.failed],
        }


@dataclasses.dataclass(frozen=True)
class Sample:
    """One version of one input: its name in the output and its global index."""

    stem: str
    path: Path
    index: int


@dataclasses.dataclass(frozen=True)
class Degraded:
    """A sample with its pictures, (H, W, 3) float32 encoded sRGB, and a recipe of the drawn parameters."""

    sample: Sample
    clean: np.ndarray
    noisy: np.ndarray
    drawn: Recipe


@dataclasses.dataclass(frozen=True)
class Work:
    """All samples that `inputs` and `count` make: sample k, from 0, is version k % count of input k // count.

    Args:
        inputs: images and folders of images.
        recipe: takes and gives encoded sRGB: a recipe, a mixture, a chain, a name, or a TOML file.
        count: versions of each image.
        seed: of the root key.
        start: the global index of sample 0.
    """

    inputs: Sequence[str | Path]
    recipe: RecipeLike
    count: int = 1
    seed: int = 0
    start: int = 0
    paths: list[Path] = dataclasses.field(init=False)
    _digests: dict[Path, tuple[str, tuple[int, ...]]] = dataclasses.field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def __post_init__(self) -> None:
        check_whole("count", self.count, 1)
        check_whole("start", self.start, 0)
        check_seed(self.seed)
        check_runs(self.degradation)
        object.__setattr__(self, "paths", find_images(self.inputs))
        if self.start > (1 << 31) - 1 - len(self):
            raise InputError(f"start = {self.start}: sample indices go from 0 to {(1 << 31) - 2}")

    def __len__(self) -> int:
        return len(self.paths) * self.count

    @functools.cached_property
    def degradation(self) -> Degradation:
        """The recipe or mixture that `recipe` stands for."""
        return find_degradation(self.recipe)

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the recipe's TOML."""
        return hashlib.sha256(self.degradation.to_toml().encode()).hexdigest()

    @functools.cached_property
    def inputs_real(self) -> frozenset[str]:
        """The inputs without links, the recipe's file too, which no output may replace."""
        return real_paths([*self.paths, *recipe_files(self.recipe)])

    def sample(self, k: int) -> Sample:
        path, version = self.paths[k // self.count], k % self.count
        return Sample(f"{path.stem}_{version:03d}", path, self.start + k)

    def run(
        self, which: range, outcome: Outcome, done: Callable[[Sample], bool] = lambda sample: False
    ) -> Iterator[Degraded]:
        """Degrade these samples, those apart that are `done`; out of order where sizes differ.

        The device computes one batch while the one before it is used, and the next one read. Pictures of many
        sizes share frames, where their results do not depend on it. Where there are more than two sizes, all
        that the process has compiled is forgotten, but for the programs of this work: see `Programs`.
        """
        key, before = jax.random.key(self.seed), None
        for batch in self._batches(which, outcome, done):
            indices = np.asarray([sample.index for sample, _ in batch], np.int32)
            images = [image for _, image in batch]
            if frame := self._frames.of(_size(images[0])):
                filled, indices, sizes = _framed(images, indices, frame, self._at_once[frame])
            else:
                filled, sizes = np.stack(images), None
            sizes = None if frame in self._frames.exact else sizes
            check_levels(filled, self.degradation.name)
            noisy, _, params = self._programs(self.degradation, key, filled, indices, sizes)
            if before is not None:
                yield from self._fetch(*before)
            before = batch, noisy, params
        if before is not None:
            yield from self._fetch(*before)

    @functools.cached_property
    def _programs(self) -> Programs:
        return Programs(_degraded)

    @functools.cached_property
    def _frames(self) -> Frames:
        margin = self.degradation.margin
        if margin is None or not by_index(jax.random.key(self.seed)):
            return Frames()
        return shared_frames(self._counts, margin)

    @functools.cached_property
    def _counts(self) -> Counter[Size]:
        """Pictures by size, as the headers of some tell."""
        some = self.paths[:: -(-len(self.paths) // MOST_SIZED)]
        return Counter(size for size in map(size_of, some) if size)

    @functools.cached_property
    def _at_once(self) -> dict[Size, int]:
        """Pictures of a batch, by frame: as many in each, and so few that all frames' may wait."""
        own: Counter[Size | None] = Counter()
        for size, pictures in self._counts.items():
            own[self._frames.of(size)] += self.count * pictures
        found = {}
        for frame in self._frames.sizes:
            most = max(1, WAITING_PIXELS // (MOST_FRAMES * frame[0] * frame[1]))
            batches = -(-max(own[frame], 1) // most)
            found[frame] = -(-max(own[frame], 1) // batches)
        return found

    def _fetch(self, batch: list[tuple[Sample, np.ndarray]], noisy: Any, params: Any) -> Iterator[Degraded]:
        noisy, params = jax.device_get((noisy, params))
        for i, (sample, clean) in enumerate(batch):
            drawn = jax.tree.map(lambda leaf, i=i: leaf[i], params)
            own = noisy[i, : clean.shape[0], : clean.shape[1]]
            yield Degraded(sample, clean, own, self._drawn(sample, drawn))

    def digest_of(self, path: Path) -> str:
        """SHA-256 of an input, taken once; "" where it cannot be read."""
        if path not in self._digests:
            try:
                before = file_state(path)
                self._digests[path] = digest_of(path), before
            except InputError:
                self._digests[path] = "", ()
        return self._digests[path][0]

    def _drawn(self, sample: Sample, params: dict[str, Any]) -> Recipe:
        note = {"sample": self.note(sample)}
        recipe = self.degradation
        if isinstance(recipe, Mixture):
            recipe, params = recipe.drawn(params)
        return Recipe(recipe.chain, params, f"the parameters drawn for {sample.stem}", note)

    def note(self, sample: Sample) -> dict[str, Any]:
        """What says which sample of which run it is."""
        return {
            "source": sample.path.name,
            "source_sha256": self.digest_of(sample.path),
            "recipe": self.degradation.name,
            "recipe_sha256": self.digest,
            "seed": self.seed,
            "index": sample.index,
        }

    def _batches(
        self, which: range, outcome: Outcome, done: Callable[[Sample], bool]
    ) -> Iterator[list[tuple[Sample, np.ndarray]]]:
        """Samples of one size, or of one frame, together, so that it is compiled once; the last batch may be
        smaller, and those of many sizes, which do not wait for more of each."""
        waiting: dict[Size, list[tuple[Sample, np.ndarray]]] = defaultdict(list)
        namesakes = self._namesakes()

        def pixels(size: Size) -> int:
            return size[0] * size[1] * len(waiting[size])

        for i in range(which.start // self.count, -(-which.stop // self.count)):
            own = range(max(which.start, i * self.count), min(which.stop, (i + 1) * self.count))
            samples = [sample for sample in map(self.sample, own) if not done(sample)]
            outcome.kept += len(own) - len(samples)
            image = self._read(self.paths[i], namesakes, outcome) if samples else None
            if image is None:
                continue
            frame = self._frames.of(_size(image))
            size = frame or _size(image)
            many = self._at_once[frame] if frame else max(1, BATCH_PIXELS // (size[0] * size[1]))
            for sample in samples:
                waiting[size].append((sample, image))
                if len(waiting[size]) == many:
                    yield waiting.pop(size)
            if sum(map(pixels, waiting)) > WAITING_PIXELS:
                yield waiting.pop(max(waiting, key=pixels))
        yield from waiting.values()

    def _namesakes(self) -> dict[str, list[Path]]:
        found: dict[str, list[Path]] = defaultdict(list)
        for path in self.paths:
            found[path.stem].append(path)
        return found

    def _read(self, path: Path, namesakes: dict[str, list[Path]], outcome: Outcome) -> np.ndarray | None:
        try:
            own = namesakes[path.stem]
            if other := next(filter(_is_sound, own[: own.index(path)]), None):
                raise InputError(f"{path}: {other} has the same name, which outputs would share")
            if len(os.fsencode(f"{path.stem}_{self.count - 1:03d}.clean.png")) > MOST_NAME:
                raise InputError(f"{path}: its name is too long for those of its results; shorten it")
            self.digest_of(path)  # before the pixels: of what is read, not of what stands there later
            image = read_image(path)
            if file_state(path) != self._digests[path][1]:
                raise InputError(f"{path}: changed while it was read")
            return image
        except InputError as error:
            outcome.failed.append((str(path), str(error)))
            return None


def _size(image: np.ndarray) -> Size:
    return image.shape[0], image.shape[1]


def _degraded(degradation: Degradation, *given: Any) -> Any:
    return degradation.degrade(*given)


def _framed(
    images: list[np.ndarray], indices: np.ndarray, frame: Size, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images, indices and sizes of a whole batch: frames with a picture each, the first of them again at the
    end."""
    rows = [*range(len(images)), *[0] * (count - len(images))]
    images = [images[i] for i in rows]
    framed = np.zeros((count, *frame, 3), np.float32)
    for own, image in zip(framed, images):
        own[: image.shape[0], : image.shape[1]] = image
    return framed, indices[rows], np.array([*map(_size, images)], np.int32)


def _is_sound(path: Path) -> bool:
    """Whether a picture can be read; all of it is, as much that is wrong shows in no other way."""
    try:
        read_image(path)
    except InputError:
        return False
    return True
