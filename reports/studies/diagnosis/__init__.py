"""Planted mistakes, and how often `certpgo.diagnose` names them first."""
