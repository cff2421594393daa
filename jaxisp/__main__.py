"""`python -m jaxisp`, and the command `jaxisp`."""

from jaxisp.process import signals


def main() -> int:
    """Run the command line as a process of its own."""
    try:
        signals.watch()  # before all that takes time to import
        from jaxisp.cli import main as command

        status = command()
    except BaseException:
        number = signals.came()
        if number is None:
            raise
        signals.tell()  # whatever the signal became on its way through libraries
        status = signals.status_of(number)
    if signals.came() and status:
        signals.leave(status)
    return status


if __name__ == "__main__":
    raise SystemExit(main())
