"""The state of the base from an inertial measurement unit (IMU), the joints, and the contacts that hold."""
