"""What the verdict is decided by: every threshold, an instance for each kind of pairs.

Shares are of the gap above its floor unless said otherwise. A unit is the floor, or `least_unit` where the
floor is below that.
"""

import dataclasses

from jaxisp.gap.simulator.effects import CLEAN_NOISY, JPEG_JPEG, RAW_JPEG


@dataclasses.dataclass(frozen=True, kw_only=True)
class Criteria:
    """Thresholds of a diagnosis.

    The gap:
        least_unit: the unit where the floor is smaller. In squared 8-bit steps: most compressed files have a
            floor of 4 to 36; what is harmless is no smaller where a file is not compressed, and its floor
            0.1. Of statistics 1: their differences are in units of what is harmless, of which chance is a
            part.
        null_excess: [units] how far above the floor the gap of a camera that lacks nothing may be: its
            demosaicker and its order of steps are not quite the base's. From the null bank's cameras.
        null_drop: [units] by how much an effect may lower that camera's gap all the same. Measured by
            `experiments.null_drops` (RAW+JPEG: docs/results/diagnosis.json).

    An effect by itself (`Trial.accepted`):
        smallest: share that the lower end of an effect's interval must be above; CONTRACT's 0.05.
        farthest: share by which an effect may raise the mean square distance of pixels, noise and all.
            Statistics are blind to much: a warp of several pixels smooths noise as well, but what it shows is
            elsewhere. No out-of-library effect of the withheld study brought pixels nearer by as much.
        nearer: share of that distance by which one effect must be nearer than another to be told from it.
        cleared: share of the distance beyond the noise that must go for pixels to show an effect by
            themselves.
        most_of_rest: share of what earlier causes leave, from which on an effect needs to be sure of a part
            of that alone: how scenes vary in what other causes explain does not count against it.
        least_of_rest: share of what is left that the lower end of an effect's interval must be above: many
            effects lower some statistics a little. 0 of pixels.

    Effects beside each other:
        leading: share that an effect must close to be preferred to one that closes more, because pixels or
            the files show it; film grain must close as much.
        as_much: share of what the best closes from which on another closes about as much: a form that is not
            quite right costs a fifth.
        imitated: share of what an effect closes that another must close to be preferred where the first can
            imitate it in full.
        simpler: likewise, where the other has fewer parameters.
        apart: [units] by how much what two effects leave must differ for them to be told apart: in
            statistics by what is harmless, in pixels by a share of the gap only (no bound).
        left_alike: times as much as the winner leaves from which on even an effect that is easily taken for
            it is told apart.

    The search:
        begins: share that the first effect must close for others to be looked for beside it, unless it closes
            more than `null_excess`.
        most_causes: effects that are accepted at most.
        refitted: effects of a step that are refitted: those that close most by screening.
        predicted: share that an effect must close by screening to be refitted.
        anew: whether the best of a later step are fitted once more, all columns anew: the base there has
            imitated what was missing. Not of pixels, whose columns are computed anew at every step.
        hopeless: times the least error of all forms that a form may leave at first for the base to be fitted
            beside it.
        between_forms: share of a form's error that its effect must leave where its numbers are free, to be
            between forms.
        chosen_anew: share of the error that another variant of the base must leave beside an effect to be
            taken.

    Film grain, and what is named:
        grain_of_rest: share of what causes leave that film grain must close: what another effect leaves in
            flat areas is less.
        named: probability from which an effect is named; the report says how sure it is.

    What the report says:
        clear: p-value, held against the null bank, above which an axis is not said to have a gap.
        by_chance: p-value by chance alone that an axis of what is left must be below; p-values of the bank
            are not as fine.
        named_axis: share of the gap that an axis must have to be named.
        considerable: share of the gap left that is worth a word and a measurement.
    """

    least_unit: float
    null_excess: float
    null_drop: float
    smallest: float = 0.05
    farthest: float = 0.2
    nearer: float = 0.05
    cleared: float = 0.5
    most_of_rest: float = 0.67
    least_of_rest: float
    leading: float = 0.25
    as_much: float = 0.8
    imitated: float = 0.93
    simpler: float = 0.98
    apart: float
    left_alike: float = 2.0
    begins: float = 0.1
    most_causes: int = 3
    refitted: int = 6
    predicted: float = 0.01
    anew: bool
    hopeless: float = 4.0
    between_forms: float = 0.9
    chosen_anew: float = 0.98
    grain_of_rest: float = 0.5
    named: float = 0.3
    clear: float = 0.05
    by_chance: float = 0.01
    named_axis: float = 0.02
    considerable: float = 0.15


CRITERIA = {
    RAW_JPEG: Criteria(
        least_unit=4.0,
        null_excess=0.5,
        null_drop=0.1,
        least_of_rest=0.0,
        apart=float("inf"),
        anew=False,
    ),
    CLEAN_NOISY: Criteria(
        least_unit=1.0,
        null_excess=1.3,
        null_drop=0.7,
        least_of_rest=0.15,
        apart=0.35,
        anew=True,
    ),
}
CRITERIA[JPEG_JPEG] = CRITERIA[RAW_JPEG]
"""By kind of pairs."""
