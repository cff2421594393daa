"""Cameras that nobody here wrote: RawTherapee, darktable and LibRaw, one switch on over a plain profile.

    python -m experiments.third_party make --data DATA -o CASES --half develop
    python -m experiments.third_party run CASES -o RESULTS
    python -m experiments.third_party table RESULTS
    python -m experiments.third_party collect RESULTS --half sealed

`make` needs `rawtherapee-cli` and `darktable-cli`, which are driven by their command lines alone.
"""
