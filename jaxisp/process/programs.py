"""What is compiled, and how long it takes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

QUICK: dict[str, Any] = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    # others may not know it, and would stop
    **({"xla_cpu_use_fusion_emitters": False} if version("jaxlib").startswith("0.10.") else {}),
}
"""`compiler_options` of `jax.jit` for a program that runs a few times on little: on a CPU it compiles in a
quarter of the time and runs ten times as long. Sums of many terms depend on the number of devices then."""


@dataclass(frozen=True)
class Program:
    """A program that was made."""

    name: str
    trace_s: float
    """Seconds in Python, to find out what it computes."""
    lower_s: float
    """Seconds to write that down for XLA."""
    compile_s: float
    """Seconds in XLA; or to read the program, where such are kept (`keep_compiled`)."""

    @property
    def seconds(self) -> float:
        return self.trace_s + self.lower_s + self.compile_s

    def __str__(self) -> str:
        steps = f"trace {self.trace_s:.2f}, lower {self.lower_s:.2f}, compile {self.compile_s:.2f}"
        return f"{self.seconds:6.2f} s  {self.name} ({steps})"


@contextmanager
def compile_times() -> Iterator[list[Program]]:
    """List the programs that are compiled within, in the order in which they were; a second call adds none.

    Times are wall clock, as JAX reports them. A program within another is part of that.

    Example:
        >>> import jaxisp, numpy as np
        >>> blur, image = jaxisp.stage("optical_blur"), np.ones((9, 11, 3), np.float32)
        >>> with jaxisp.compile_times() as programs:
        ...     picture = jaxisp.run(blur, blur.init(), image)
        >>> [program.name for program in programs][-1]
        'compiled'
        >>> with jaxisp.compile_times() as programs:
        ...     picture = jaxisp.run(blur, blur.init(), image)
        >>> programs
        []
    """
    from jax import monitoring

    found: list[Program] = []
    steps: dict[tuple[str, str], float] = {}
    over = False

    def heard(event: str, duration_secs: float, **about: Any) -> None:
        if over or not event.startswith("/jax/core/compile/"):
            return
        name = str(about.get("fun_name", "?"))
        # tracing tells of a function, the other steps of its program
        name = name[name.find("(") + 1 : -1] if name.endswith(")") else name
        step = event.rsplit("/", 1)[1]
        steps[step, name] = duration_secs
        if step == "backend_compile_duration":
            trace, lower = (steps.pop((k, name), 0.0) for k in (_TRACE, _LOWER))
            found.append(Program(name, trace, lower, duration_secs))

    monitoring.register_event_duration_secs_listener(heard)  # jax 0.7 does not take it back
    try:
        yield found
    finally:
        over = True


_TRACE, _LOWER = "jaxpr_trace_duration", "jaxpr_to_mlir_module_duration"
