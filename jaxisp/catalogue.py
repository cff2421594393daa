"""What there is, as plain tables: stages and recipes for listings and documentation."""

from typing import Any

import numpy as np

from jaxisp.params import specs
from jaxisp.pipeline import sections, signature
from jaxisp.priors import is_distribution
from jaxisp.recipes import RECIPES
from jaxisp.serialize import encode_params
from jaxisp.stages import STAGES


def describe_stages() -> list[dict[str, Any]]:
    """Every registered stage: name, summary, parameters, static options, gradient, source, domains."""
    return [_describe(name) for name in sorted(STAGES)]


def _describe(name: str) -> dict[str, Any]:
    declared, text = signature(STAGES[name]), sections(STAGES[name])
    parameters = specs(declared.params).items() if declared.params else ()
    return {
        "name": name,
        "summary": text["Summary"],
        "params": [
            {
                "name": field,
                "default": np.asarray(spec.default).tolist(),
                "bounds": list(spec.bounds),
                "unit": spec.unit,
                "scale": spec.scale,
                "doc": spec.doc,
            }
            for field, spec in parameters
        ],
        "static": [{"name": option, "default": default} for option, default in declared.static],
        "stochastic": declared.stochastic,
        "takes": declared.domain_in.name,
        "gives": declared.domain_out.name,
        "gradient": text.get("Gradient", ""),
        "source": text.get("Source", ""),
    }


def describe_recipes() -> list[dict[str, Any]]:
    """Every built-in recipe: name, description, stages in order, what is drawn and what is fixed."""
    return [_describe_recipe(name) for name in RECIPES]


def _describe_recipe(name: str) -> dict[str, Any]:
    recipe = RECIPES[name]()
    encoded = encode_params(recipe.prior)
    drawn = {
        f"{stage}.{field}": " ".join(f"{kind} {numbers}" for kind, numbers in value.items())
        for stage, fields in encoded.items()
        for field, value in fields.items()
        if is_distribution(getattr(recipe.prior[stage], field))
    }
    return {
        "name": name,
        "description": recipe.description,
        "stages": [s.name for s in recipe.chain.stages()],
        "draws": drawn,
        "params": encoded,
    }
