"""Questions to a cost map, each described once: its fields, its answer, and how it is answered.

A request names every field with its type, unit, bounds, default and meaning. The command line makes its options of them
(`commands.asked`), the Python package and the client make the parameters of their methods of them (`asking`), and HTTP
takes the request as its body. What answers loads slowly, so it is imported by the functions that use it.
"""
