"""The evaluation of the diagnosis: results of studies in one file, and the tables that show them.

    python -m experiments.evaluation             # the tables of docs/diagnosis-evaluation.md
    python -m experiments.evaluation collect GROUP=FILE ... --axes FILE ... -o docs/results/diagnosis.json

`collect` takes files that `experiments.withheld.study` wrote and keeps of each case what the tables need. A
case in more than one file of a group counts as the last has it; so does one in both `nulls` and `main`. The
files of `experiments.fresh_scenes` and `experiments.null_drops` are kept as they are.
"""
