"""Transport that records its messages."""

from collections.abc import Callable

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Transport, TransportWrapper
from wbc_controller.recording.recorder import Recorder


class RecordingTransport(TransportWrapper):
    """Wrapper that records messages; outgoing ones after they were sent."""

    def __init__(self, transport: Transport, recorder: Recorder) -> None:
        super().__init__(transport)
        self._recorder = recorder

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        publish = self._transport.advertise(endpoint)
        record, topic = self._recorder.record_outgoing, self._recorder.channel(endpoint.name, endpoint.type)

        def send(payload: bytes) -> None:
            publish(payload)
            record(topic, payload)

        return send

    def _receiver(self, endpoint: Endpoint) -> Callable[[bytes], bool]:
        record, topic = self._recorder.record_incoming, self._recorder.channel(endpoint.name, endpoint.type)

        def receive(payload: bytes) -> bool:
            record(topic, payload)
            return True

        return receive

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Return True with a subscription, or if the whole run is recorded."""
        return self._recorder.whole_run or self._transport.has_reader(endpoint)
