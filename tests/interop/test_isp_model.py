"""`isp_model` as BSRGAN's degradations call it, and a function for Hugging Face's `map`."""

import multiprocessing
import pickle

import numpy as np
import pytest
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.interop import DegradeExamples, IspModel
from jaxisp.pipeline import Chain, stage
from jaxisp.recipe import Recipe
from jaxisp.recipes import amwgn, awgn
from jaxisp.testing import smooth_image


def test_it_gives_a_pair_of_any_size_and_layout():
    model = IspModel(amwgn(), seed=1)
    for shape in ((40, 33, 3), (64, 64, 3), (7, 9, 3)):
        clean, other = smooth_image(shape), np.zeros((4, 4, 3), np.float32)
        before = clean.copy()
        noisy, hq = model.forward(clean, other)
        assert noisy.shape == shape and noisy.dtype == np.float32 and hq is other
        assert noisy.min() >= 0 and noisy.max() <= 1 and not np.array_equal(noisy, clean)
        np.testing.assert_array_equal(clean, before)
    overshot, _ = model(1.2 * np.ones((32, 32, 3), np.float64))
    assert overshot.max() <= 1


def test_calls_differ_and_repeat():
    clean = smooth_image((32, 32, 3))
    one, two = IspModel(awgn(), seed=3), IspModel(awgn(), seed=3)
    first = [one(clean)[0] for _ in range(3)]
    np.testing.assert_array_equal(first, [two(clean)[0] for _ in range(3)])
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], IspModel(awgn(), seed=4)(clean)[0])


def test_its_draws_are_the_recipes(monkeypatch):
    """The picture is filled up to a multiple and cut again: within the old size nothing else happens."""
    import jax

    clean, recipe = smooth_image((30, 40, 3)), awgn()
    filled = np.pad(clean, ((0, 2), (0, 24), (0, 0)), mode="reflect")
    key = jax.random.fold_in(jax.random.key(9), 0)
    want = np.asarray(recipe.degrade(key, filled[None])[0])[0, :30, :40]
    np.testing.assert_array_equal(IspModel(recipe, seed=9)(clean)[0], want)


def test_what_is_no_picture_is_refused():
    model = IspModel(awgn())
    for wrong in (
        np.zeros((8, 8), np.float32),
        np.zeros((8, 8, 3), np.uint8),
        np.zeros((3, 8, 8), np.float32),
    ):
        with pytest.raises(InputError, match=r"\(H, W, 3\) floats"):
            model(wrong)
    with pytest.raises(InputError, match="not photographs"):
        IspModel(Recipe(Chain((stage("demosaic_bilinear"),), "raw"), {}))


def _forked(model, out):
    try:
        model(np.zeros((32, 32, 3), np.float32))
    except InputError as error:
        out.put(str(error))


@pytest.mark.filterwarnings(
    "ignore:os.fork", "ignore:.*fork.*:DeprecationWarning", "ignore:.*fork.*:RuntimeWarning"
)
def test_a_forked_worker_is_refused_in_words():
    model = IspModel(awgn())
    model(np.zeros((32, 32, 3), np.float32))
    context = multiprocessing.get_context("fork")
    out = context.Queue()
    child = context.Process(target=_forked, args=(model, out))
    child.start()
    assert "spawn" in out.get(timeout=60)
    child.join(60)


def test_it_can_be_sent_to_a_worker():
    model = IspModel(amwgn(), seed=2)
    clean = smooth_image((32, 32, 3))
    sent = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(sent(clean)[0], model(clean)[0])


def test_examples_depend_on_their_index_alone():
    pictures = [
        Image.fromarray(np.uint8(255 * smooth_image(s, i)))
        for i, s in enumerate([(20, 30, 3)] * 3 + [(33, 20, 3)])
    ]
    function = DegradeExamples(amwgn(), seed=4)
    whole = function({"image": pictures}, [0, 1, 2, 3])["noisy"]
    assert [p.size for p in whole] == [p.size for p in pictures]
    part = function({"image": [np.asarray(pictures[3]), pictures[1]]}, [3, 1])["noisy"]
    np.testing.assert_array_equal(part[0], whole[3])
    np.testing.assert_array_equal(part[1], whole[1])
    with pytest.raises(InputError, match="no column 'picture'"):
        DegradeExamples(awgn(), image="picture")({"image": pictures}, [0])
    with pytest.raises(InputError, match="row 7"):
        function({"image": [np.zeros((4, 4))]}, [7])
    for wrong in (({"image": pictures},), ({"image": pictures[0]}, 0)):
        with pytest.raises(InputError, match="batched=True, with_indices=True"):
            function(*wrong)


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_hugging_face_refuses_other_calls_in_words():
    datasets = pytest.importorskip("datasets")
    pictures = [Image.fromarray(np.zeros((8, 8, 3), np.uint8))] * 4
    dataset = datasets.Dataset.from_dict({"image": pictures}).cast_column("image", datasets.Image())
    for options in ({"batched": True}, {"with_indices": True}):
        with pytest.raises(InputError, match="batched=True, with_indices=True"):
            dataset.map(DegradeExamples("awgn"), **options)
    with pytest.raises(InputError, match="without num_proc"):
        dataset.map(DegradeExamples("awgn"), batched=True, with_indices=True, num_proc=2)


def test_hugging_face_maps_it():
    datasets = pytest.importorskip("datasets")
    pictures = [Image.fromarray(np.uint8(255 * smooth_image((24, 32, 3), i))) for i in range(5)]
    dataset = datasets.Dataset.from_dict({"image": pictures}).cast_column("image", datasets.Image())
    function = DegradeExamples(amwgn(), seed=4)
    mapped = [
        dataset.map(function, batched=True, with_indices=True, batch_size=n, load_from_cache_file=False)
        for n in (2, 5)
    ]
    assert mapped[0].column_names == ["image", "noisy"]
    for a, b, clean in zip(mapped[0], mapped[1], pictures):
        np.testing.assert_array_equal(a["noisy"], b["noisy"])
        assert 0 < np.abs(np.asarray(a["noisy"], float) - np.asarray(clean, float)).mean() < 60
