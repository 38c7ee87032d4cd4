"""The cost F of a graph: residuals, derivatives and the matrices that it is made of."""
