"""A biped's gait."""

from wbc_controller.walking.gait import Gait

GAIT = Gait(
    single=0.5, double=0.1, shift=0.8, height=0.7, lowering=0.02, clearance=0.05, rough_clearance=0.1,
    width=0.2, least_width=0.14, length=0.45, greatest_width=0.55, reaction=0.08, speed=(0.5, 0.2, 0.5),
)  # fmt: skip
