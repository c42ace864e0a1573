"""hybrid."""
from .automaton import *
from .errors import *
from .simulate import simulate
