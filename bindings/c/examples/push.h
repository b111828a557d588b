/* A scene of roles, shared by the examples on a computer and on a microcontroller. */
#ifndef PUSH_H
#define PUSH_H

#include <rigidformer.h>

enum { PUSH_STEPS = 20, PUSH_UNITS = 4, PUSH_POINTS = 64 };

/* A driven pusher shoves a box across a fixed table that stands beside a ramp. A unit is added after
   8 steps, and the table is removed after 14. The simulator needs room for PUSH_UNITS units of
   PUSH_POINTS points; planes, gravity and time step are those of this scene afterwards. `sum` is an
   FNV-1a hash of all units' internal poses after each step: the numbers by which two processors are
   compared. `box` is where the box ends. */
rf_status push(rf_simulator *simulator, uint64_t *sum, rf_pose *box);

#endif
