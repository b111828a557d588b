"""Numbers that scene files and models share. Without PyTorch, so that whoever makes scenes need not load it."""

#: Roles of units: moved by the model; given a pose for the next step from outside; scenery.
FREE, DRIVEN, FIXED = 0, 1, 2

#: Planes of a scene, at most.
MAX_PLANES = 8
#: A unit that is a body of its own.
OWN_BODY = -1
#: Body numbers are smaller.
BODIES = 65535
