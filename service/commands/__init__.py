"""The commands of `joulemap`, a module per purpose; heavy parts are imported inside them so `--help` is instant."""
