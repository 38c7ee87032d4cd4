"""Adversarial cases for certifiers: what is true of a point, and what each certifier says of it."""
