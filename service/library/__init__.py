"""The Python package: what `import joulemap` offers, for scripts and notebooks."""
