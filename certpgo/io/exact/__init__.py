"""From decimals in a file to exact rotations and correctly rounded weights."""
