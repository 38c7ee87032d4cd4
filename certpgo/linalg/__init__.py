"""Arrays in, arrays out: rotations, block matrices, factorizations, eigenpairs."""
