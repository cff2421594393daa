"""Abuse: damaged files, processes killed at random moments, full disks. Figures in docs/results/abuse.md."""
