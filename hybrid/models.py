"""The gallery: ``from hybrid.models.bouncing_ball import BouncingBall``.

In a checkout its files lie beside this package; an installed package has them in a folder of this
name, and not this file.
"""

from .gallery import folder

__path__ = [str(folder())]
