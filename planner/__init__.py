"""Which way, and is there enough energy?"""

if __name__ != "joulemap.planner":  # in a checkout the folder is importable by its own name too: never two copies
    raise ImportError(f"import joulemap.planner, not {__name__}: joulemap's code has one name")
