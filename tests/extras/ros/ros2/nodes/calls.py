"""A service, an action, and six topics on a four-thread executor; calls and publishes so many times, prints what came.

usage: calls.py COUNT
"""

import json
import os
import sys
import threading
import time

import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

COUNT = int(sys.argv[1])
TOPICS = 6
rclpy.init()
node = rclpy.create_node("calls")
group = ReentrantCallbackGroup()
requests, responses, orders, feedback, results = [], [], [], [], []
received = [[] for _ in range(TOPICS)]


def serve(request, response):
    """Answer with the number of the request."""
    requests.append(request.int32_value)
    response.int32_value = request.int32_value
    return response


def execute(goal):
    """Report one step, and return as many numbers as were ordered."""
    orders.append(goal.request.order)
    goal.publish_feedback(Fibonacci.Feedback(sequence=[goal.request.order]))
    goal.succeed()
    return Fibonacci.Result(sequence=[1] * min(goal.request.order, 9))


node.create_service(BasicTypes, "/add", serve, callback_group=group)
caller = node.create_client(BasicTypes, "/add", callback_group=group)
server = ActionServer(node, Fibonacci, "/count", execute, callback_group=group)
client = ActionClient(node, Fibonacci, "/count", callback_group=group)
qos = QoSProfile(depth=1000)
publishers = []
for topic in range(TOPICS):
    node.create_subscription(
        Float64,
        f"/number{topic}",
        lambda message, topic=topic: received[topic].append(message.data),
        qos,
        callback_group=group,
    )
    publishers.append(node.create_publisher(Float64, f"/number{topic}", qos))
executor = MultiThreadedExecutor(4)
executor.add_node(node)
threading.Thread(target=executor.spin, daemon=True).start()


def wait(future):
    """The result of a future."""
    end = time.monotonic() + 3.0
    while not future.done():
        if time.monotonic() > end:
            return None
        time.sleep(0.002)
    return future.result()


def pump(topic):
    """Publish from a thread of its own."""
    for number in range(COUNT):
        publishers[topic].publish(Float64(data=float(number)))
        time.sleep(0.001)


caller.wait_for_service()
client.wait_for_server()
while not all(publisher.get_subscription_count() for publisher in publishers):
    time.sleep(0.01)
time.sleep(0.3)
pumps = [threading.Thread(target=pump, args=(topic,)) for topic in range(TOPICS)]
for thread in pumps:
    thread.start()
for number in range(1, 6):
    answer = wait(caller.call_async(BasicTypes.Request(int32_value=number)))
    responses.append(answer.int32_value if answer else None)
for order in range(1, 4):
    goal = wait(
        client.send_goal_async(Fibonacci.Goal(order=order), lambda message: feedback.extend(message.feedback.sequence))
    )
    result = wait(goal.get_result_async())
    results.append(len(result.result.sequence))
for thread in pumps:
    thread.join()
end = time.monotonic() + 5.0
while any(len(numbers) < COUNT for numbers in received) and time.monotonic() < end:
    time.sleep(0.01)
sys.stdout.write(
    json.dumps(
        {
            "asked": requests,
            "responses": responses,
            "orders": orders,
            "feedback": feedback,
            "results": results,
            "received": received,
        }
    )
)
sys.stdout.flush()


os._exit(0)
