"""All tables, one after the other: `python -m experiments.denoisers DATA --work RUNS --seeds 0 1 2`."""

from experiments.denoisers import ablations, demosaicking, noise_models, raw_input, sanity
from experiments.denoisers.study import main

for module in (noise_models, ablations, demosaicking, sanity, raw_input):
    main(module.TABLE)
