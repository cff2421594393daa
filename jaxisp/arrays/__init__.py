"""Array operations that XLA compiles well: barriers, safe maths, planes, stencils, strips, batches."""
