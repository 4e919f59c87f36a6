"""A store as one page that needs no other file: pictures, planes and curves of its frames.

``planewise view`` on the command line.
"""

from planewise.gallery.page import Shown, write_gallery

__all__ = ["Shown", "write_gallery"]
