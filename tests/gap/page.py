"""A report and pictures that pages are made of, and what reads such a page."""

import copy
from html.parser import HTMLParser

import numpy as np

from jaxisp.gap.features.spectra import spreads
from jaxisp.gap.report.page import html
from jaxisp.gap.report.record import ABSORBED, FARTHER

CAUSE = {
    "effect": "vignetting",
    "site": "scene",
    "gap_before": 17.6,
    "gap_after": 4.2,
    "closed": 0.812,
    "ci": [0.76, 0.853],
    "alternatives": [],
    "next_measurement": None,
    "p_value": 1e-9,
    "probability": 0.97,
    "params": {"a2": -0.41234},
}
REPORT = {
    "schema": 1,
    "kind": "raw+jpeg",
    "base": {
        "stages": ["demosaicking"],
        "fitted": {"tone_curve": {"knots": [0.0, 3.0, 4.0]}, "black": {"level": 64.0}},
        "fitted_after": {"tone_curve": {"knots": [0.0, 3.0, 4.5]}, "black": {"level": 64.0}},
        "absorbed": {"white_balance": 0.94},
    },
    "pairs": {
        "fit": ["a"],
        "held_out": ["<script>alert(1)</script>"],
        "aligned": [
            {"name": "a", "shift_px": [2.0, -1.0], "scale": [1.0, 1.0], "done": "moved", "certain": True},
            {"name": "b", "shift_px": [0.0, 0.0], "scale": [1.0, 1.0], "done": "nothing", "certain": False},
        ],
        "left_out": [],
        "failed": [],
    },
    "gap": {
        "metric": "mean square, squared steps",
        "before": 17.6,
        "after": 4.2,
        "floor": 1.0,
        "ci": [3.5, 5.0],
    },
    "verdict": "effect",
    "causes": [CAUSE],
    "ranking": [
        {"effect": "vignetting", "closed": 0.812, "status": "accepted", "ci": [0.7, 0.9]},
        {
            "effect": "color_shading",
            "closed": 0.31,
            "status": "rejected",
            "ci": [0.2, 0.4],
            "possible": False,
            "reason": FARTHER,
        },
        {"effect": "sharpening", "closed": 0.1, "status": "rejected", "predicted": 0.1},
        {"effect": "white_balance", "closed": -0.02, "status": "absorbed", "reason": ABSORBED},
    ],
    "where": [
        {"axis": "radius", "share": 0.7, "p_value": 0.005, "bins": [0.1, 0.2], "profile": [0.0, -3.0]},
        {"axis": "cfa_phase", "share": 0.2, "p_value": 0.005, "bins": ["0,0", "<b>"], "profile": [1.0, -1.0]},
        {"axis": "row", "share": 0.1, "p_value": 0.005, "bins": list(range(99)), "profile": [0.5] * 99},
        {"axis": "tail", "share": 0.01, "p_value": 0.6, "bins": [], "profile": []},
    ],
    "unexplained": {"share": 0.19, "axes": ["edge"], "description": "19 % of the gap is left, on edge"},
    "seconds": 61.7,
}
GREY = np.full((40, 60, 3), 0.5)
NOISE = np.random.default_rng(0).normal(size=(2, 32, 32, 3))
PICTURES = {
    "name": "<i>one</i>",
    "target": GREY,
    "before": GREY,
    "after": GREY,
    "residual_before": np.zeros((24, 44, 3)),
    "residual_after": np.zeros((24, 44, 3)),
    **{f"spread_{whose}": spreads(NOISE, np.ones(NOISE.shape[:3])) for whose in ("before", "after", "floor")},
}


class Balance(HTMLParser):
    """Fails where a tag is closed that is not open."""

    VOID = ("meta", "link", "img", "rect", "line", "polyline", "path", "circle")

    def __init__(self, text):
        super().__init__()
        self.open, self.pictures = [], 0
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.pictures += tag == "img"
        assert tag != "script"
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


STATISTIC = {
    "axis": "block_phase",
    "share": 0.6,
    "p_value": 0.001,
    "bins": ["comb Cb0", "logvar columns2", "<b>own</b>", *(f"logvar rows{k}" for k in range(5))],
    "profile": [-16.5, 4.0, 8.25, *[0.5] * 5],
    "unit": "what is harmless or chance",
}


def changed(**more):
    return copy.deepcopy(REPORT) | more


def shown(report, pictures=PICTURES):
    return html(report, pictures).replace("\N{NO-BREAK SPACE}", " ")
