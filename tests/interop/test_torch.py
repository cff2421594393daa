"""PyTorch's own loaders over recipes: shared memory, workers, the bits of `jaxisp.data`."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from jaxisp.data import Batches, CleanImages, CleanPatches  # noqa: E402
from jaxisp.errors import InputError  # noqa: E402
from jaxisp.interop import IspModel  # noqa: E402
from jaxisp.interop.torch import (  # noqa: E402
    CleanDataset,
    DegradedBatches,
    degraded,
    from_torch,
    loader,
    to_torch,
)
from jaxisp.recipes import amwgn  # noqa: E402
from jaxisp.testing import smooth_image  # noqa: E402


def patches():
    images = tuple(np.uint16(65535 * smooth_image((40, 48, 3), i)) for i in range(3))
    return CleanPatches(CleanImages(("a", "b", "c"), images), 16, per_image=4, seed=1)


def reference(count):
    with Batches(patches(), amwgn(), batch=4, seed=7) as batches:
        return [tuple(np.moveaxis(np.asarray(x), -1, 1) for x in next(batches)) for _ in range(count)]


def test_memory_is_shared():
    noisy = amwgn().degrade(_key(), np.zeros((2, 16, 16, 3), np.float32))[0]
    tensor = to_torch(noisy)
    assert tensor.data_ptr() == noisy.unsafe_buffer_pointer() and tensor.shape == (2, 3, 16, 16)
    assert tensor.is_contiguous(memory_format=torch.channels_last)
    back = from_torch(tensor)
    assert back.unsafe_buffer_pointer() == noisy.unsafe_buffer_pointer()
    np.testing.assert_array_equal(back, noisy)
    with pytest.raises(InputError, match="float32"):
        from_torch(tensor.double())


def _key():
    import jax

    return jax.random.key(0)


def test_a_loader_of_degraded_batches():
    dataset = DegradedBatches(patches(), amwgn(), batch=4, seed=7)
    batches = iter(torch.utils.data.DataLoader(dataset, batch_size=None))
    for want, _ in zip(reference(3), range(3)):
        for got, own in zip(next(batches), want):
            assert isinstance(got, torch.Tensor)
            np.testing.assert_array_equal(got.numpy(), own)


@pytest.mark.slow
def test_degraded_batches_refuse_workers():
    dataset = DegradedBatches(patches(), amwgn(), batch=4)
    options = {"num_workers": 1, "multiprocessing_context": "spawn"}
    broken = torch.utils.data.DataLoader(dataset, batch_size=None, **options)
    with pytest.raises(InputError, match="num_workers=0"):
        next(iter(broken))


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_workers_cut_and_the_main_process_degrades(workers):
    batches = loader(CleanDataset(patches(), epochs=2), batch_size=4, num_workers=workers)
    for (noisy, clean), want in zip(degraded(batches, amwgn(), seed=7), reference(4)):
        np.testing.assert_array_equal(noisy.numpy(), want[0])
        np.testing.assert_array_equal(clean.numpy(), want[1])


def test_a_training_step_runs_on_it():
    network = torch.nn.Conv2d(3, 3, 3, padding=1)
    optimizer = torch.optim.SGD(network.parameters(), 0.1)
    losses = []
    for _, (noisy, clean) in zip(range(4), DegradedBatches(patches(), amwgn(), batch=4)):
        loss = ((network(noisy) - clean) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0]


class Pairs(torch.utils.data.Dataset):
    """As BSRGAN's data set: an `isp_model` within a worker."""

    def __init__(self, model):
        self.model = model

    def __len__(self):
        return 4

    def __getitem__(self, index):
        clean = smooth_image((32, 32, 3), 1)
        return self.model.forward(clean.copy(), clean)


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_a_forked_worker_of_a_loader_is_refused_in_words():
    options = {"num_workers": 1, "multiprocessing_context": "fork", "timeout": 60}
    batches = torch.utils.data.DataLoader(Pairs(IspModel("awgn")), **options)
    with pytest.raises(InputError, match="multiprocessing_context='spawn'"):
        next(iter(batches))


@pytest.mark.slow
def test_isp_model_in_spawned_workers_has_a_stream_each():
    batches = torch.utils.data.DataLoader(
        Pairs(IspModel(amwgn(), seed=5)), batch_size=1, num_workers=2, multiprocessing_context="spawn"
    )
    drawn = [noisy.numpy() for noisy, _ in batches]
    again = [noisy.numpy() for noisy, _ in batches]
    np.testing.assert_array_equal(drawn, again)
    assert len({d.tobytes() for d in drawn}) == 4
