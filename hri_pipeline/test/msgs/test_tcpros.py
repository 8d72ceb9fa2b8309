"""publish() sends at once what a connection takes, and the rest later; images are received without copies; messages of
any type."""

import copy
import socket
import struct
import sys
import threading
import time
from io import BytesIO

import numpy as np
import pytest
import rospy
from rospy.exceptions import TransportException, TransportTerminated
from rospy.impl import tcpros_base, tcpros_pubsub
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String

from hri_pipeline.ros import tcpros
from hri_pipeline.ros.tcpros import PromptConnection, ReceivedImage, receive_without_copies


class Wire:
    """A connection that keeps what is written."""

    def __init__(self):
        self.done, self.sent, self.news = False, [], threading.Event()

    def set_cleanup_callback(self, callback):
        self.callback = callback

    def write_data(self, data):
        self.sent.append(data)
        if data == b"last":
            self.news.set()

    def close(self):
        self.done = True
        self.callback(self)


@pytest.fixture
def sleeps(monkeypatch):
    """Every sleep of rospy's connections from now on."""
    monkeypatch.setattr(tcpros_pubsub, "time", time)
    taken = []
    monkeypatch.setattr(time, "sleep", taken.append)
    return taken


def write(messages, kind):
    wire = Wire()
    connection = kind(wire, 100)
    try:
        for message in messages:
            connection.write_data(message)
        assert wire.news.wait(10.0)
    finally:
        wire.close()
        connection._thread.join(10.0)
    assert not connection._thread.is_alive()
    return wire.sent


MESSAGES = [b"%d" % number for number in range(20)] + [b"last"]


def test_rospy_sleeps_for_each_message(sleeps):
    assert write(MESSAGES, tcpros_pubsub.QueuedConnection) == MESSAGES
    assert sleeps == [0] * len(MESSAGES)


def test_it_does_not_any_more_and_all_is_sent_in_order(sleeps):
    assert write(MESSAGES, PromptConnection) == MESSAGES
    assert sleeps == []


@pytest.fixture
def prompt():
    """A call that returns a connection with a queue of some size, and the socket of its subscriber."""
    opened = []

    def make(queue_size):
        ours, theirs = socket.socketpair()
        for end in (ours, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 ** 15)
        transport = tcpros_base.TCPROSTransport(tcpros_pubsub.TCPROSPub("/topic", String), "/topic")
        transport.set_socket(ours, "subscriber")
        connection = PromptConnection(transport, queue_size)
        opened.append((connection, theirs))
        return connection, theirs

    yield make
    for connection, theirs in opened:
        theirs.close()
        connection.close()
        connection._thread.join(10.0)
        assert not connection._thread.is_alive()


def wait_until_sent(connection):
    """Wait until the thread of a connection has found out that all is sent."""
    for _ in range(1000):
        with connection._lock:
            if not (connection._is_sending or connection._queue):
                return
        threading.Event().wait(0.01)
    raise AssertionError("the thread goes on sending")


def test_a_message_is_on_its_way_when_publish_returns(prompt):
    connection, theirs = prompt(1)
    connection._cond_data_available.notify = lambda: pytest.fail("the thread is woken for it")
    for message in MESSAGES:
        connection.write_data(message)
    assert theirs.recv(1000, socket.MSG_DONTWAIT) == b"".join(MESSAGES)
    assert (connection.stat_num_msg, connection.stat_bytes) == (len(MESSAGES), len(b"".join(MESSAGES)))
    del connection._cond_data_available.notify


class Narrow:
    """A socket that takes so many bytes (`room`) without waiting, and its connection, which waits."""

    def __init__(self, room):
        self.room, self.taken, self.meanwhile = room, b"", lambda: None
        self.socket, self.done, self.stat_bytes, self.stat_num_msg = self, False, 0, 0

    def gettimeout(self):
        return None

    def send(self, data, flags):
        part = bytes(data[:self.room])
        if not part:
            raise BlockingIOError
        self.room -= len(part)
        self.taken += part
        return len(part)

    def write_data(self, data):
        self.meanwhile()
        self.taken += data

    def set_cleanup_callback(self, callback):
        pass


@pytest.mark.parametrize("room", [0, 3])
@pytest.mark.parametrize("while_it_is_sent", [False, True])
def test_no_message_overtakes_one_that_waits_or_is_in_parts(monkeypatch, room, while_it_is_sent):
    """A connection that has room again in that moment."""
    monkeypatch.setattr(PromptConnection, "_run", lambda connection: None)
    wire, woken = Narrow(room), []
    connection = PromptConnection(wire, 10)
    connection._cond_data_available.notify = lambda: woken.append(0)
    connection.write_data(b"abcdef")
    assert wire.taken == b"abc"[:room] and woken
    wire.room = 100
    if while_it_is_sent:
        wire.meanwhile = lambda: setattr(wire, "meanwhile", lambda: None) or connection.write_data(b"gh")
    else:
        connection.write_data(b"gh")
        assert wire.taken == b"abc"[:room]
    connection._send_waiting()
    if while_it_is_sent:
        assert wire.taken == b"abcdef"
        connection._send_waiting()
    assert wire.taken == b"abcdefgh"


def test_who_does_not_read_stops_nobody_and_gets_whole_messages_the_begun_one_and_the_last(prompt):
    connection, theirs = prompt(2)
    large = [bytes([number]) * 2 ** 20 for number in range(40)]
    for message in large:
        connection.write_data(message)
    theirs.settimeout(10.0)
    received = bytearray()
    while not received.endswith(large[-1]):
        received += theirs.recv(2 ** 20)
    found = [received[start] for start in range(0, len(received), 2 ** 20)]
    assert b"".join(large[number] for number in found) == received
    assert found[0] == 0 and found[-2:] == [38, 39] and len(found) < 10 and found == sorted(set(found))
    connection.write_data(b"small")
    assert theirs.recv(100) == b"small"
    wait_until_sent(connection)
    assert connection.stat_bytes == len(received) + len(b"small")
    assert connection.stat_num_msg == len(found) + 1


def test_nothing_is_kept_of_what_was_sent(prompt):
    connection, theirs = prompt(0)
    large = [bytes([number]) * 2 ** 20 for number in range(6)]
    before = [sys.getrefcount(message) for message in large]
    for message in large:
        connection.write_data(message)
    del message
    theirs.settimeout(10.0)
    left = 6 * 2 ** 20
    while left:
        left -= len(theirs.recv(left))
    wait_until_sent(connection)
    assert [sys.getrefcount(message) for message in large] == before


def test_a_socket_on_which_python_would_wait_is_left_to_the_thread(prompt):
    connection, theirs = prompt(1)
    connection._connection.socket.settimeout(60.0)
    connection._send = lambda data, send=connection._send: pytest.fail("sent") if send(data) else 0
    connection.write_data(b"message")
    theirs.settimeout(10.0)
    assert theirs.recv(100) == b"message"


def test_who_has_gone_is_told_with_a_later_message(prompt):
    connection, theirs = prompt(2)
    theirs.close()
    connection.write_data(b"lost")
    connection._thread.join(10.0)
    assert connection.done
    with pytest.raises(TransportTerminated):
        connection.write_data(b"more")


def test_all_connections_of_this_process_are_such(monkeypatch):
    monkeypatch.setattr(rospy.topics, "QueuedConnection", tcpros_pubsub.QueuedConnection)
    tcpros.send_at_once()
    assert rospy.topics.QueuedConnection is PromptConnection


def wire_of(message):
    """A message as it is sent, its length first."""
    buffer = BytesIO()
    message.serialize(buffer)
    return struct.pack("<I", len(buffer.getvalue())) + buffer.getvalue()


def picture(number, width=640, height=480):
    rows = np.random.default_rng(number).integers(0, 256, 3 * width * height, np.uint8)
    return Image(header=Header(seq=number, frame_id="camera_\u00e4"), width=width, height=height, step=3 * width,
                 encoding="bgr8", is_bigendian=1, data=rows.tobytes())


@pytest.fixture
def connect(monkeypatch):
    """A call that returns rospy's end of a connection for messages of a type, and the socket of the publisher."""
    monkeypatch.setattr(tcpros_pubsub.TCPROSSub, "read_messages", tcpros_base.TCPROSTransportProtocol.read_messages)
    receive_without_copies()
    monkeypatch.setattr(tcpros_base, "is_shutdown", lambda: False)
    opened = []

    def connection(kind, buffer_bytes, queue_size=1):
        opened.extend(socket.socketpair())
        transport = tcpros_base.TCPROSTransport(
            tcpros_pubsub.TCPROSSub("/image", kind, queue_size=queue_size, buff_size=buffer_bytes), "/image")
        transport.socket, transport.header = opened[-2], {"callerid": "/camera"}
        opened[-1].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 ** 22)
        opened[-2].settimeout(20.0)
        return transport, opened[-1]

    yield connection
    for one in opened:
        one.close()


def send(publisher, data):
    thread = threading.Thread(target=publisher.sendall, args=(data,), daemon=True)
    thread.start()
    return thread


def test_an_image_arrives_as_it_was_and_is_not_copied(connect):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    for number in (1, 2):
        send(publisher, wire_of(picture(number)))
        image, = transport.receive_once()
        sent = picture(number)
        assert isinstance(image, Image) and isinstance(image.data, memoryview)
        assert bytes(image.data) == sent.data and image._connection_header == {"callerid": "/camera"}
        for name in ("header", "width", "height", "step", "encoding", "is_bigendian"):
            assert getattr(image, name) == getattr(sent, name)
        assert np.frombuffer(image.data, np.uint8).flags.writeable, "the block that the socket has written into"


def test_of_the_images_that_have_come_the_newest_is_taken_and_a_part_of_the_next_waits(connect):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    pieces = [wire_of(picture(number, 64, 48)) for number in range(5)]
    for data in pieces[:3] + [pieces[3][:1000]]:
        publisher.sendall(data)
    assert transport.receive_once()[0].header.seq == 2
    publisher.sendall(pieces[3][1000:] + pieces[4][:2])
    assert transport.receive_once()[0].header.seq == 3
    publisher.sendall(pieces[4][2:])
    assert transport.receive_once()[0].header.seq == 4


@pytest.mark.parametrize("queue_size, kept", [(1, [3]), (2, [2, 3]), (None, [0, 1, 2, 3])])
def test_as_many_are_kept_as_the_queue_holds(connect, queue_size, kept):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES, queue_size)
    for number in range(4):
        publisher.sendall(wire_of(picture(number, 64, 48)))
    images = transport.receive_once()
    assert [image.header.seq for image in images] == kept
    assert [bytes(image.data) for image in images] == [picture(number, 64, 48).data for number in kept]


def test_images_that_come_faster_than_they_are_read_are_handed_on(connect, monkeypatch):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    numbers, receive = iter(range(100)), tcpros._receive

    def receive_slowly(*arguments):
        publisher.sendall(wire_of(picture(next(numbers), 64, 48)))
        return receive(*arguments)

    monkeypatch.setattr(tcpros, "_receive", receive_slowly)
    publisher.sendall(wire_of(picture(0, 64, 48)))
    transport.receive_once()
    assert next(numbers) < 5


def test_what_was_read_with_the_handshake_belongs_to_the_first_image(connect):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    data = wire_of(picture(7))
    transport.read_buff.write(data[:3])
    send(publisher, data[3:])
    image, = transport.receive_once()
    assert image.header.seq == 7 and bytes(image.data) == picture(7).data


@pytest.mark.parametrize("sent", [100, 5])
def test_a_connection_that_ends_within_an_image_is_over(connect, sent):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    publisher.sendall(wire_of(picture(1))[:sent])
    publisher.close()
    with pytest.raises(TransportTerminated):
        transport.receive_once()


def test_a_connection_that_is_closed_between_two_images_is_over(connect, monkeypatch):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    receive, own = tcpros._receive, transport.socket

    def receive_and_close(*arguments):
        block = receive(*arguments)
        own.close()
        return block

    monkeypatch.setattr(tcpros, "_receive", receive_and_close)
    publisher.sendall(wire_of(picture(1, 64, 48)))
    with pytest.raises(TransportTerminated, match="closed"):
        transport.receive_once()


@pytest.mark.parametrize("body", [b"", bytes(20), bytes(12) + b"\xff" * 40, wire_of(picture(1, 8, 8))[4:-1]])
def test_an_image_that_is_none_is_refused(connect, body):
    transport, publisher = connect(ReceivedImage, ReceivedImage.BUFFER_BYTES)
    publisher.sendall(struct.pack("<I", len(body)) + body)
    with pytest.raises(TransportException, match="Deserialization"):
        transport.receive_once()


def test_other_messages_are_received_as_before(connect):
    transport, publisher = connect(String, 65536)
    publisher.sendall(wire_of(String("one")) + wire_of(String("two")))
    assert [message.data for message in transport.receive_once()] == ["two"]


def any_message(message, **header):
    buffer = BytesIO()
    message.serialize(buffer)
    found = tcpros.AnyMessage().deserialize(buffer.getvalue())
    found._connection_header = dict({"type": message._type, "md5sum": message._md5sum}, **header)
    return found


def test_a_message_of_any_type_has_the_fields_of_its_own():
    found = any_message(String("Ann"))
    assert found.data == "Ann" and tcpros.message_of(found) == String("Ann")
    assert copy.deepcopy(found).data == copy.copy(found).data == "Ann"
    with pytest.raises(AttributeError, match="transforms"):
        print(found.transforms)
    for header in ({"type": "nowhere/Nothing"}, {"md5sum": "0" * 32}):
        with pytest.raises(AttributeError, match="not known here"):
            print(any_message(String("Ann"), **header).data)


def test_the_bytes_of_a_message_that_the_program_has_read_already():
    assert tcpros.bytes_of(String("Ann")) == tcpros.bytes_of(any_message(String("Ann")))
