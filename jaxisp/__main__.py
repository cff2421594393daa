"""`python -m jaxisp`."""

from jaxisp.cli import main

raise SystemExit(main())
