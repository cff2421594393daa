"""Learning-rate schedules and the optimizer of a run."""

import optax

from jaxisp.train.config import TrainConfig

_STAIRCASE = 1e-5  # what the learning rate falls to over a run, as in Jaroensri et al. 2019


def schedule(config: TrainConfig, epoch_steps: int) -> optax.Schedule:
    """The learning rate by step.

    Args:
        config: says the law, the rate, the steps and the warm-up.
        epoch_steps: steps in an epoch, for the law that falls once each.
    """
    warmup = min(config.warmup, config.steps - 1)
    rest = config.steps - warmup
    if config.schedule == "cosine":
        law = optax.cosine_decay_schedule(config.lr, rest)
    elif config.schedule == "staircase":
        each = min(epoch_steps, rest)
        law = optax.exponential_decay(config.lr, each, _STAIRCASE ** (each / rest), staircase=True)
    else:
        law = optax.constant_schedule(config.lr)
    if not warmup:
        return law
    rise = optax.linear_schedule(config.lr / (warmup + 1), config.lr, warmup)
    return optax.join_schedules([rise, law], [warmup])


def make_optimizer(config: TrainConfig, epoch_steps: int) -> optax.GradientTransformation:
    """Clipping, Adam, weight decay and the schedule, as one transformation."""
    parts = [optax.clip_by_global_norm(config.clip_norm)] if config.clip_norm else []
    parts.append(optax.scale_by_amsgrad() if config.optimizer == "amsgrad" else optax.scale_by_adam())
    if config.weight_decay:
        parts.append(optax.add_decayed_weights(config.weight_decay))
    return optax.chain(*parts, optax.scale_by_learning_rate(schedule(config, epoch_steps)))
