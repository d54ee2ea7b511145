"""Draft of a configuration, printed by `wbc new`.

`draft.py` runs the steps. Each adds values with notes on their origin (`notes.py`).

1. `mechanism.py`: joints in URDF order. Joints that move less than 1/200 of the mass, such as fingers, are locked.
   Missing limits get placeholders.
2. `feet.py`: feet are the lowest ends of the kinematic tree, of similar height on similar limbs. With two or more feet,
   no other part as low, and a root link not called ``world``, the base floats.
3. `foot_shape.py`: a flat sole makes a surface contact, a round foot a point contact, and a body of revolution about a
   continuous joint a wheel.
4. `posture.py`: the SRDF's posture if the robot can stand in it, else the nearest such posture, or one with bent legs
   (`standing_posture.py`).
5. `tuning.py`: tasks, gains and limits of the supplied robots. Stiffnesses scale with g/h at the height h of the centre
   of mass, forces with the weight.
"""
