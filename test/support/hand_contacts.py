"""Contacts of the left hand of G1 with random placements."""

import pinocchio as pin

from wbc_controller.inverse_dynamics import contacts

HANDS = ("left_wrist_yaw_link", "right_wrist_yaw_link")


def random_place(rng):
    return pin.SE3(pin.exp3(rng.normal(size=3)), 0.2 * rng.normal(size=3))


def a_surface(model, rng, **options):
    return contacts.SurfaceContact("c", model, HANDS[0], random_place(rng), contacts.Rectangle(0.1, 0.05), **options)


def a_point(model, rng, **options):
    return contacts.PointContact("c", model, HANDS[0], rng.normal(size=3), 0.05, normal=rng.normal(size=3), **options)


def a_wheel(model, rng, **options):
    centre, axle, normal = rng.normal(size=(3, 3))
    return contacts.RollingContact("c", model, HANDS[0], centre, 0.1, axle, normal=normal, **options)


def a_fixed(mask):
    return lambda model, rng, **options: contacts.FixedContact("c", model, HANDS[0], random_place(rng), mask, **options)
