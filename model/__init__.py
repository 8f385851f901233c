"""What does it cost to drive there?"""

if __name__ != "joulemap.model":  # in a checkout the folder is importable by its own name too: never two copies
    raise ImportError(f"import joulemap.model, not {__name__}: joulemap's code has one name")
