"""Who asks, what is kept, what is answered?"""

if __name__ != "joulemap.service":  # in a checkout the folder is importable by its own name too: never two copies
    raise ImportError(f"import joulemap.service, not {__name__}: joulemap's code has one name")
