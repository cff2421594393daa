"""`as_stored` under the name that scripts outside the package import it by."""

from jaxisp.gap.pairs.stored import as_stored

__all__ = ["as_stored"]
