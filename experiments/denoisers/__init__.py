"""Denoisers trained on simulated cameras, measured on real photographs: one module a table.

    python -m experiments.denoisers.noise_models DATA --work RUNS --seeds 0 1 2
    python -m experiments.denoisers DATA --work RUNS --seeds 0 1 2                  # all tables

DATA holds iphone7/ (a RAW+JPEG pair), iphone8/, polyu/, sidd/ (clean+noisy pairs) and clean/. RUNS takes the
training runs and all that has been computed: a command that was stopped goes on where it was. Results are
added to docs/results/denoisers.{json,md}.
"""
