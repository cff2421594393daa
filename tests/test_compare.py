"""Two reports on one page: as the commands write them, matched by name."""

import copy
import itertools
import json

import pytest

from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.report.compare import compare, comparison_page, read_report

FIT = {
    "camera": "a.toml",
    "pairs": [{"name": n, "held_out_psnr": 30.0 + i, "held_out_ssim": 0.9} for i, n in enumerate("xyz")],
    "held_out": {"psnr": 31.0, "ssim": 0.9, "how": "tiles"},
    "seconds": 20.0,
    "design": "demosaic_ahd",
    "parameters": [{"name": "unsharp_mask.amount", "value": 0.5, "relative_error": 0.1, "identified": True}],
}
DIAGNOSIS = {
    "schema": 1,
    "kind": "raw+jpeg",
    "verdict": "effect",
    "causes": [{"effect": "vignetting"}],
    "gap": {"metric": "mean squared error", "before": 9.0, "after": 2.0, "floor": 1.0, "ci": [1.5, 2.5]},
    "ranking": [{"effect": "vignetting", "closed": 0.875}, {"effect": "saturation", "closed": -0.1}],
    "probabilities": {"vignetting": 0.99, "none": 0.0},
    "where": [{"axis": "radius", "share": 0.7}],
    "unexplained": {"share": 0.125, "axes": []},
    "seconds": 60.0,
}
EVALUATION = {
    "pairs": [{"name": n, "psnr_in": 28.0, "ssim_in": 0.8, "psnr": 30.0, "ssim": 0.9} for n in "xy"],
    "mean": {"psnr_in": 28.0, "ssim_in": 0.8, "psnr": 30.0, "ssim": 0.9},
    "aligned": "all",
    "normalised": "mean and deviation",
    "light": "linear",
    "methods": [{"name": "tv", "mean": {"psnr": 29.0}}],
}


def written(folder, report, **changes):
    path = folder / "report.json"
    folder.mkdir()
    path.write_text(json.dumps(copy.deepcopy(report) | changes))
    return folder


def values(result):
    return {(row["group"], row["name"]): (row["a"], row["b"], row["change"]) for row in result["values"]}


@pytest.mark.parametrize(
    ("report", "changes", "wanted"),
    [
        (FIT, {"held_out": {"psnr": 33.5, "ssim": 0.95, "how": "tiles"}}, ("held out", "PSNR", 31.0, 33.5)),
        (DIAGNOSIS, {"verdict": "none", "causes": []}, ("verdict", "causes", "vignetting", "none")),
        (
            EVALUATION,
            {"methods": [{"name": "tv", "mean": {"psnr": 28.5}}]},
            ("mean", "PSNR of tv", 29.0, 28.5),
        ),
    ],
    ids=["fit", "diagnose", "evaluate"],
)
def test_two_reports_of_a_kind(tmp_path, report, changes, wanted, capsys):
    a, b = written(tmp_path / "a", report), written(tmp_path / "b", report, **changes)
    group, name, old, new = wanted
    change = new - old if isinstance(old, float) else None
    assert values(compare(a, b))[group, name] == (old, new, change)
    same = compare(a, a)
    assert not any(row["change"] for row in same["values"])
    page = tmp_path / "new" / "page.html"
    assert main(["compare", str(a), str(b / "report.json"), "-o", str(page), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert values(told)[group, name] == (old, new, change) and told["page"] == str(page)
    text = page.read_text()
    assert all(row["name"] in text for row in told["values"])
    assert main(["compare", str(a), str(b)]) == 0
    assert name in capsys.readouterr().out


def test_pairs_and_effects_of_one_report_alone(tmp_path):
    others = [*FIT["pairs"][1:], {**FIT["pairs"][0], "name": "new"}]
    a, b = written(tmp_path / "a", FIT), written(tmp_path / "b", FIT, pairs=others)
    found = values(compare(a, b))
    group = "PSNR of each pair, held out"
    assert found[group, "x"] == (30.0, None, None) and found[group, "new"] == (None, 30.0, None)
    assert found[group, "y"] == (31.0, 31.0, 0.0)
    order = [row["group"] for row in compare(a, b)["values"]]
    assert len(list(dict.fromkeys(order))) == 1 + sum(x != y for x, y in itertools.pairwise(order))
    assert "new" in comparison_page(compare(a, b)).html()


def test_numbers_that_no_float_can_hold(tmp_path):
    a, b = written(tmp_path / "a", FIT, seconds=10**400), written(tmp_path / "b", FIT)
    found = compare(a, b)
    assert values(found)["held out", "time"] == (10**400, FIT["seconds"], None)
    assert "1" + "0" * 400 in comparison_page(found).html()


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("{}", "is no report of jaxisp"),
        ("[1]", "damaged"),
        ("nothing", "damaged"),
        (json.dumps({"pairs": 3, "held_out": 1, "seconds": 1}), "damaged, or a report of another version"),
        (json.dumps(FIT | {"pairs": [{"name": "x"}]}), "damaged, or a report of another version"),
        (json.dumps(DIAGNOSIS), "give two of one kind"),
    ],
)
def test_what_is_no_report_is_one_error(tmp_path, content, what, capsys):
    a = written(tmp_path / "a", FIT)
    b = tmp_path / "b.json"
    b.write_text(content)
    page = tmp_path / "page.html"
    assert main(["compare", str(a), str(b), "-o", str(page)]) == 2
    told = capsys.readouterr().err
    assert what in told and str(b) in told and told.count("\n") == 1 and not page.exists()


def test_a_report_is_not_overwritten(tmp_path, capsys):
    a = written(tmp_path / "a", FIT) / "report.json"
    before = a.read_bytes()
    assert main(["compare", str(a), str(a), "-o", str(a)]) == 2
    assert a.read_bytes() == before and "overwritten" in capsys.readouterr().err
    for name in ("report.json", "report.html"):  # of the folder that is given, too
        assert main(["compare", str(a.parent), str(a.parent), "-o", str(a.parent / name)]) == 2
        assert a.read_bytes() == before and "overwritten" in capsys.readouterr().err
    with pytest.raises(InputError, match="cannot be read"):
        read_report(tmp_path / "none.json")
