"""Endpoints and valid names of a controller."""

from collections.abc import Mapping

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.decoding import Vocabulary
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, NODES, WALKING_KEYS, Endpoint, endpoints
from wbc_controller.settings import NODE_NAME, Settings, contacts, tasks


def make_vocabulary(settings: Settings, model: RobotModel) -> Vocabulary:
    """Collect the valid names of messages."""
    kinds = {name: task.type for name, task in settings.tasks.items()}
    joints, reference_frames = {}, {}
    for name, task in settings.tasks.items():
        if isinstance(task, tasks.PostureTask | tasks.TorqueTask):
            joints[name] = tuple(task.joints) or model.driven_joints
        elif isinstance(task, tasks.RelativePoseTask):
            reference_frames[name] = task.reference_frame
        elif isinstance(task, tasks.ContactWrenchTask):
            contact = settings.contacts[task.contact]
            whole = isinstance(contact, contacts.SurfaceContact | contacts.FixedContact)
            frame = contact.frame if whole else contact.against  # None: world axes, for a point or wheel on the world
            if frame is not None:
                reference_frames[name] = frame
    robot_frames = frozenset(frame.name for frame in model.pinocchio.frames)
    return Vocabulary(kinds, joints, tuple(settings.contacts), robot_frames, reference_frames)


def named_frames(settings: Settings) -> tuple[str, ...]:
    """Return the frames of all tasks and contacts."""
    named = [task.frame for task in settings.tasks.values() if hasattr(task, "frame")]
    named += [contact.frame for contact in settings.contacts.values()]
    return tuple(dict.fromkeys(named))


def controller_endpoints(
    settings: Settings,
    model: RobotModel,
    *,
    node: str = NODE_NAME,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> list[Endpoint]:
    """Expand the controller's topic table for one robot."""
    unused = set() if settings.walking is not None else set(WALKING_KEYS)
    if not settings.control.markers_rate:
        unused.add("markers")
    topics = [topic for topic in CONTROLLER_TOPICS if topic.key not in unused]
    frames = dict.fromkeys([model.base_link, *named_frames(settings)])
    return endpoints(topics, node, settings, frames=frames, namespace=namespace, remappings=remappings)


def topics_of(
    settings: Settings, namespace: str = "/", remappings: Mapping[str, str] | None = None
) -> dict[tuple[str, str, str], Endpoint]:
    """Return the topics of all nodes, by node, key and subject."""
    frames = named_frames(settings)
    return {
        (owner, topic.key, topic.subject): topic
        for owner, (node, table) in NODES.items()
        for topic in endpoints(table, node, settings, frames=frames, namespace=namespace, remappings=remappings)
    }
