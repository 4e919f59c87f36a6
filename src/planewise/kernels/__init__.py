"""The compiled loops. Nothing else in the package is compiled.

Each module calls nothing outside itself, so that what is cached for it depends on its own text
alone. All loops release the interpreter's lock.
"""
