"""What the verdict is decided by: every threshold, an instance for each kind of pairs.

Shares are of the gap above its floor unless said otherwise. A unit is the floor, or `least_unit` where the
floor is below that.
"""

import dataclasses

from jaxisp.gap.simulator.effects import AXES, CLEAN_NOISY, JPEG_JPEG, RAW_JPEG


@dataclasses.dataclass(frozen=True, kw_only=True)
class Criteria:
    """Thresholds of a diagnosis.

    The gap:
        least_unit: [squared 8-bit steps] the unit where the floor is smaller. Most compressed files have a
            floor of 4 to 36; what is harmless is no smaller where a file is not compressed, and its floor
            0.1. 0 for statistics, whose floor is 1.
        null_excess: [units] how far above the floor the gap of a camera that lacks nothing may be: its
            demosaicker and its order of steps are not quite the base's. From the null bank's cameras.
        null_drop: [units] by how much an effect may lower that camera's gap all the same. Measured by
            `experiments.null_drops` (RAW+JPEG: docs/results/null-drops.json).

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
        leading: share that the first cause must close: less does not account for a gap, an out-of-library
            effect looks like that.
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

    Whether causes account for a gap (`account`), from the withheld study's cameras (docs/diagnosis.md):
        accounted: pairs of [units] and shares: where causes leave more than the first above the floor, all
            together must close the second.
        accounted_nearer: likewise, where causes bring pixels nearer by `farthest`.
        main_axis: share of the gap an axis must have to be one that it lies on.
        kept, seen: share of that, and [units], that may be left on such an axis.
        formless: axes that any error of form shows on, and rounding and compression. Of statistics all but
            those of place and direction: how much of the noise a filter takes out, and at which scale, is a
            matter of its form.
        sure: p-value below which an axis has something left; statistics have chance in their unit.
        above_floor: whether the axes' shares are of what is above the floor, as those of statistics are.
        clearly_off: times the noise that a bias of pixels must be to say that edges are elsewhere.
        still_off: share of that bias that may be left.
        grain_of_rest: share of what causes leave that film grain must close: what another effect leaves in
            flat areas is less.

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
    most_causes: int = 3
    refitted: int = 6
    predicted: float = 0.01
    anew: bool
    hopeless: float = 4.0
    between_forms: float = 0.9
    chosen_anew: float = 0.98
    accounted: tuple[tuple[float, float], ...]
    accounted_nearer: tuple[tuple[float, float], ...] = ((0.5, 0.67),)
    main_axis: float = 0.1
    kept: float
    seen: float
    formless: frozenset[str]
    sure: float
    above_floor: bool
    clearly_off: float = 3.0
    still_off: float = 0.5
    grain_of_rest: float = 0.5
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
        accounted=((0.5, 0.67),),
        kept=0.3,
        seen=0.15,
        formless=frozenset({"lag", "tail", "block_phase"}),
        sure=0.01,
        above_floor=False,
    ),
    CLEAN_NOISY: Criteria(
        least_unit=0.0,
        null_excess=1.0,
        null_drop=0.7,
        least_of_rest=0.15,
        apart=0.35,
        anew=True,
        accounted=((0.3, 0.85), (1.2, 0.93)),  # statistics are imitated more closely than pixels
        kept=0.5,
        seen=0.5,
        formless=frozenset(AXES)
        - {"row", "column", "radius", "orientation", "fixed_pattern", "neighbourhood"},
        sure=float("inf"),
        above_floor=True,
    ),
}
CRITERIA[JPEG_JPEG] = CRITERIA[RAW_JPEG]
"""By kind of pairs."""
