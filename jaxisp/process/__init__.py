"""The process that jaxisp runs in: compiled programs kept, cores, memory, the compiler's self-check."""
