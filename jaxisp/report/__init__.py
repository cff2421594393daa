"""Self-contained HTML pages: pictures inside, no script, no request to the network."""

from jaxisp.report.page import Page

__all__ = ["Page"]
