"""The compiled loops, and how they are compiled and kept. Nothing else in the package is compiled.

Loops take arrays and numbers and know of no class. All release the interpreter's lock.
"""
