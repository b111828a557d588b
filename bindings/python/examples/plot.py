"""Predicts the embedded scene and draws it beside the record: writes prediction.png."""
import matplotlib.pyplot as plt
import numpy as np

import rigidformer as rf

scene = rf.Dataset.embedded().scene(0)
predicted = rf.rollout(rf.Model("edge"), scene, step=5, last_frame=120)
figure, (heights, errors) = plt.subplots(1, 2, figsize=(11, 4))
seconds = predicted.frames / scene.frame_rate_hz
heights.plot(seconds, predicted.poses[:, :, 2])
heights.set_prop_cycle(None)
heights.plot(np.arange(121) / scene.frame_rate_hz, scene.poses[:121, :, 2], ":")
heights.set(xlabel="s", ylabel="height of each unit, m (dotted: recorded)")
for name, one in [("edge", predicted), ("free fall", rf.free_fall(scene, step=5, last_frame=120))]:
    errors.plot(seconds, [one.errors(scene, int(frame))[0] for frame in one.frames], label=name)
errors.set(xlabel="s", ylabel="position error, m, RMS over units")
errors.legend()
figure.savefig("prediction.png", dpi=120, bbox_inches="tight")
