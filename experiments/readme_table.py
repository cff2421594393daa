"""The table of results in README.md, from the JSON of the results.

python -m experiments.readme_table
"""

import json
from collections.abc import Iterator
from pathlib import Path
from statistics import mean
from typing import Any

from experiments.denoisers.classical import NETWORK
from experiments.evaluation.kept import cases_of
from experiments.evaluation.page import rendered
from experiments.third_party import tables as switches
from experiments.withheld.effects import ABSORBABLE, KINDS
from experiments.withheld.tables import first_right, named, plain_to_see, table, truth

README = Path("README.md")


def rows(root: Path = Path()) -> Iterator[list[str]]:
    """What was measured, the figure, and the page that has more."""

    def read(name: str) -> Any:
        return json.loads((root / name).read_text())

    real, peers = read("docs/results/real-data.json"), read("benchmarks/results/peers.json")["families"]

    def timed(stage: str, size: str) -> Any:
        return next(r for r in peers["chain"]["rows"] if (r["stage"], r["size"]) == (stage, size))

    def against(row: Any, name: str) -> str:
        return f"{next(p['ratio'] for p in row['peers'] if p['name'] == name):.1f} times as fast"

    levels = " and ".join(f"{raw['psnr_levels_matched']:.1f}" for raw in real["develop"])
    yield ["two DNGs developed, against LibRaw at equal channel levels", f"{levels} dB", "real-data"]
    (pair,) = real["fit"]["pairs"]
    yield ["a camera fitted to the paper's iPhone 7 pair, on held-out tiles",
           f"{pair['held_out_psnr']:.1f} dB, SSIM {pair['held_out_ssim']:.3f}", "fit-phones"]  # fmt: skip
    steps = [t["rows"] for key, t in read("docs/results/denoisers.json").items()
             if key.startswith("noise_models cpu") and key.endswith("encoded unet")]  # fmt: skip
    of = {w: max(mean(r["mean"]["psnr"] for r in rows if (r["denoiser"], r["set"]) == (w, "iphone8"))
                 for rows in steps) for w in ("phone", "awgn")}  # fmt: skip
    yield ["a denoiser trained on `phone`, against one trained on white noise, each at its best step, real "
           "iPhone 8 crops", f"{of['phone'] - of['awgn']:+.1f} dB", "denoisers"]  # fmt: skip
    sets = read("docs/results/denoisers.json")["classical"]["rows"]
    for name, what in (("iphone8", "iPhone 8"), ("polyu", "PolyU"), ("sidd", "SIDD")):
        blind = {
            r["denoiser"]: r["mean"]["psnr"]
            for r in sets
            if r["set"] == name and (r["factor"] in (None, 1.0))
        }
        own = blind.pop(NETWORK)
        yield [f"the package's denoiser against the best of six of others, all blind, real {what} pairs",
               f"{own - max(blind.values()):+.1f} dB", "denoisers"]  # fmt: skip
    exact = read("benchmarks/results/exactness.json")["rows"]
    yield [
        "stages held to their references",
        f"{sum(r['passed'] for r in exact)} of {len(exact)}",
        "exactness",
    ]
    batch = 32 / (1e-3 * timed("recipe phone", "batch")["ms"])
    yield ["80x80 patches degraded by `phone`, two CPU cores", f"{batch:,.0f} a second", "performance"]
    card = read("benchmarks/results/h200/accelerator.json")["rows"][0]
    yield ["the same on one H200", f"{1e3 * card['images'] / card['ms']:,.0f} a second", "gpu"]
    yield ["nine stages, noise to JPEG, against OpenCV on two cores",
           against(timed("chain of nine stages", "batch"), "OpenCV, serial"), "performance"]  # fmt: skip
    yield ["12 MP RAW developed with AHD, against rawpy",
           against(timed("develop, AHD", "12 MP"), "rawpy postprocess, AHD"), "performance"]  # fmt: skip
    cases = cases_of(read("docs/results/diagnosis.json"), "nulls", "main")
    for kind in KINDS:
        own = [r for r in cases if (r["kind"], r["split"]) == (kind, "sealed") and plain_to_see(r)]
        own = [r for r in own if truth(r)[0] not in ABSORBABLE]
        yield [f"effects named first, withheld cameras, {kind.replace('raw+jpeg', 'RAW+JPEG')} pairs",
               f"{sum(map(first_right, own))} of {len(own)}", "../diagnosis-evaluation"]  # fmt: skip
    nulls = [r for r in cases if r["split"] == "nulls"]
    yield ["effects named where nothing is missing", f"{sum(bool(named(r)) for r in nulls)} of {len(nulls)}",
           "../diagnosis-evaluation"]  # fmt: skip
    others = switches.of_effects(read("docs/results/third-party.json")["switches"]["records"])
    yield ["effects named first, switches of RawTherapee, darktable and LibRaw",
           f"{sum(map(switches.first, others))} of {len(others)}", "../diagnosis-evaluation"]  # fmt: skip


def made(root: Path = Path()) -> str:
    head = ["measured", "result", "more"]
    page = "docs/results/{}.md"
    links = [[what, f"**{figure}**", f"[figures]({page.format(name)})".replace("results/../", "")]
             for what, figure, name in rows(root)]  # fmt: skip
    return table(head, links)


def main() -> None:
    README.write_text(rendered(README.read_text(), {"results": made()}))


if __name__ == "__main__":
    main()
