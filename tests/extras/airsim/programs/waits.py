"""Waits in all ways of the standard library, each for one second of simulated time; prints how long each took."""

import asyncio
import concurrent.futures
import datetime
import json
import queue
import select
import selectors
import threading
import time

import airsim

client = airsim.MultirotorClient()
client.confirmConnection()
took = {}


def measured(name, wait):
    before = client.getMultirotorState().timestamp
    clock = time.monotonic(), time.time(), time.perf_counter()
    result = wait()
    clocks = [now - then for now, then in zip((time.monotonic(), time.time(), time.perf_counter()), clock, strict=True)]
    seconds = 1e-9 * (client.getMultirotorState().timestamp - before)
    took[name] = [seconds, max(clocks), min(clocks), result]


def wait_for_condition():
    condition = threading.Condition()
    with condition:
        return condition.wait(1.0)


def wait_for_timer():
    event = threading.Event()
    threading.Timer(1.0, event.set).start()
    return event.wait(5.0)


def wait_for_queue():
    try:
        queue.Queue().get(timeout=1.0)
    except queue.Empty:
        return "empty"


def wait_for_thread():
    thread = threading.Thread(target=time.sleep, args=(1.0,))
    thread.start()
    thread.join()
    return thread.is_alive()


def wait_for_pool():
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda seconds: time.sleep(seconds) or seconds, (1.0, 0.5)))


async def call_later():
    done = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_later(1.0, done.set_result, client.ping())
    return await done


async def wait_for():
    try:
        await asyncio.wait_for(asyncio.Event().wait(), 1.0)
    except TimeoutError:
        return "timeout"


async def poll():
    end = asyncio.get_running_loop().time() + 1.0
    while asyncio.get_running_loop().time() < end:
        await asyncio.sleep(0)


def wait_for_lock(lock):
    lock.acquire()
    return concurrent.futures.ThreadPoolExecutor(1).submit(lock.acquire, True, 1.0).result()


def wait_for_select():
    return select.select([], [], [], 1.0)


def wait_for_date():
    end = datetime.datetime.now() + datetime.timedelta(seconds=1)
    while datetime.datetime.now() < end:
        pass


measured("Lock.acquire", lambda: wait_for_lock(threading.Lock()))
measured("RLock.acquire", lambda: wait_for_lock(threading.RLock()))
measured("select", lambda: wait_for_select()[0])
measured("poll object", lambda: select.poll().poll(1000))
measured("selector", lambda: selectors.DefaultSelector().select(1.0))
measured("datetime", wait_for_date)
measured("time.sleep", lambda: time.sleep(1.0))
measured("Event.wait", lambda: threading.Event().wait(1.0))
measured("Condition.wait", wait_for_condition)
measured("Timer", wait_for_timer)
measured("Queue.get", wait_for_queue)
measured("Thread.join", wait_for_thread)
measured("pool", wait_for_pool)
measured("asyncio.sleep", lambda: asyncio.run(asyncio.sleep(1.0)))
measured("call_later", lambda: asyncio.run(call_later()))
measured("wait_for", lambda: asyncio.run(wait_for()))
measured("to_thread", lambda: asyncio.run(asyncio.to_thread(time.sleep, 1.0)))
measured("poll", lambda: asyncio.run(poll()))

# a thread with a client of its own takes readings while the first one waits for a task
client.enableApiControl(True)
readings = []
stopped = threading.Event()


def watch():
    watching_client = airsim.MultirotorClient()
    while not stopped.wait(0.5):
        readings.append(-watching_client.simGetVehiclePose().position.z_val)


watcher = threading.Thread(target=watch)
watcher.start()
client.takeoffAsync().join()
stopped.set()
watcher.join()
took["readings"] = readings
print(json.dumps(took))
