"""Brute force: integration over excitation periods with CVODES and exactly at contact changes, and sweeps."""
