/* The cyclic exchange of one PROFINET relationship in a thread that needs no Python interpreter (docs/profinet.md).
 *
 * The core is two pure functions, bytes and times in, decisions out: `offer` judges a received frame, `provide` makes
 * the input frame when it is due. The thread around them only waits, receives and sends. Every fact of the protocol
 * is an argument of Engine(), which native.py makes from the declarations; profinet/connection/cpm.py and ppm.py are
 * the reference, and the tests compare each decision with them.
 *
 * Between the threads no lock is held. An image in either direction is three buffers: the writer fills its own one
 * and exchanges it for the shared one, the reader does the same. Frames with changed orders wait in a ring.
 */
#define _GNU_SOURCE
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { FRAME_MAX = 2048, WAITING = 32, OTHERS = WAITING / 2, NEW = 4, STACK = 256 << 10, SECOND = 1000000000 };
/* VERDICTS and COUNTS in native.py have the same order; the first seven are a Consumer's. */
enum { ACCEPTED, STOPPED, NO_DATA, LENGTH, TRANSFER, NOT_VALID, STALE, FOREIGN, OTHER, VERDICTS };
enum { SENT = VERDICTS, MISSED, INVALID, WITHHELD, DROPPED, ERRORS, OCTETS_IN, OCTETS_OUT, COUNTS };

typedef struct {
    long long number, came; /* of the frame among those that count, and when it came */
    int verdict, size;
    unsigned char data[FRAME_MAX];
} Item;

typedef struct {
    PyObject_HEAD
    /* facts: never changed */
    unsigned char head[FRAME_MAX], mask[FRAME_MAX], bad[FRAME_MAX], tag[2];
    int head_size, tag_at, tag_size, size, counter_at, status_at, transfer_at, frame_size, sent_at;
    int newest, valid, ignore, primary, run, each, step;
    long long cycle, bound;
    /* of the thread, or of the test that takes its place */
    Item last; /* the last frame that counts */
    int last_start, counter, unseen, align, mine_in, mine_out;
    long long due, move, number, in_ring;
    /* of Python's thread */
    int taking, filling;
    long long taken;
    /* between both */
    Item ring[WAITING], image[3];
    unsigned char input[3][FRAME_MAX];
    atomic_uint head_of_ring, tail_of_ring;
    atomic_int image_shared, input_shared, lost, signalled, stopping, sent_counter;
    atomic_llong heard, alive, counts[COUNTS];
    int wake_fd, stop_fd, socket_fd, running;
    pthread_t thread;
} Engine;

static int word(const unsigned char *at) { return at[0] << 8 | at[1]; }

static void wake(Engine *e)
{
    if (!atomic_exchange(&e->signalled, 1))
        (void)!write(e->wake_fd, &(uint64_t){1}, sizeof(uint64_t));
}

/* ---- received frames ------------------------------------------------------------------------------------------- */

/* Where the payload of a frame of the controller starts, 0: it is of somebody else or no PROFINET. */
static int payload_of(const Engine *e, const unsigned char *frame, int size, int *is_real_time)
{
    int type = e->tag_at, start = type + 2;
    *is_real_time = 0;
    if (size >= start && !memcmp(frame + type, e->tag, 2)) {
        type += e->tag_size;
        start += e->tag_size;
    }
    if (size < start + 2 || memcmp(frame + type, e->head + e->tag_at, 2))
        return 0;
    *is_real_time = 1;
    return memcmp(frame, e->head, e->tag_at) ? 0 : start;
}

/* As Consumer.receive. */
static int judge(Engine *e, const unsigned char *payload, int size)
{
    if (size != e->size)
        return LENGTH;
    int counter = word(payload + e->counter_at), status = payload[e->status_at];
    if (payload[e->transfer_at])
        return TRANSFER;
    if (!(status & e->valid))
        return NOT_VALID;
    if (e->counter >= 0) {
        int steps = (counter - e->counter) & 0xFFFF;
        if (steps < 1 || steps > e->newest)
            return STALE;
    }
    e->counter = counter;
    if (status & e->ignore || !(status & e->primary))
        return NO_DATA;
    return status & e->run ? ACCEPTED : STOPPED;
}

/* 2: the orders differ from those of the last frame that counts, 1: other data does, 0: nothing but the counter. */
static int changed(const Engine *e, const unsigned char *payload)
{
    const unsigned char *last = e->last.data + e->last_start;
    int found = e->number ? 0 : 2;
    for (int i = 0; found < 2 && i < e->size; i++) {
        int bits = payload[i] ^ last[i];
        if (bits & e->mask[i])
            found = 2;
        else if (bits && i != e->counter_at && i != e->counter_at + 1)
            found = 1;
    }
    return found;
}

static void fill(Item *item, long long number, long long came, int verdict, const unsigned char *frame, int size)
{
    item->number = number;
    item->came = came;
    item->verdict = verdict;
    item->size = size;
    memcpy(item->data, frame, size);
}

static int append(Engine *e, const Item *item, unsigned most)
{
    unsigned head = atomic_load(&e->head_of_ring);
    if (head - atomic_load(&e->tail_of_ring) >= most)
        return 0;
    fill(&e->ring[head % WAITING], item->number, item->came, item->verdict, item->data, item->size);
    atomic_store(&e->head_of_ring, head + 1);
    return 1;
}

/* A frame whose orders differ; before one without data the newest data, which it leaves in force. */
static void keep(Engine *e, const Item *item)
{
    int kept = item->verdict != NO_DATA || e->last.verdict == NO_DATA || e->last.number <= e->in_ring ||
               append(e, &e->last, WAITING);
    if (!kept || !append(e, item, WAITING))
        atomic_store(&e->lost, 1);
    e->in_ring = item->number;
}

/* The input frame is moved to the middle between two frames of the controller, slowly: its answer is in it then. */
static void align(Engine *e, long long now)
{
    long long after = ((e->due - now) % e->cycle + e->cycle) % e->cycle, most = e->cycle / 64;
    long long move = (e->cycle / 2 - after) / 8;
    e->move = move > most ? most : move < -most ? -most : move;
}

static int offer(Engine *e, const unsigned char *frame, int size, long long now)
{
    int is_real_time, start = payload_of(e, frame, size, &is_real_time);
    int verdict = FOREIGN;
    if (start && !memcmp(frame + start, e->head + e->head_size - 2, 2))
        verdict = judge(e, frame + start, size - start);
    else if (start)
        verdict = OTHER;
    else if (!is_real_time)
        return FOREIGN;
    atomic_fetch_add(&e->counts[verdict], 1);
    atomic_fetch_add(&e->counts[OCTETS_IN], size);
    if (verdict == OTHER) {
        fill(&e->image[e->mine_in], 0, now, verdict, frame, size);
        if (!append(e, &e->image[e->mine_in], OTHERS))
            atomic_fetch_add(&e->counts[DROPPED], 1);
        wake(e);
    }
    if (verdict > NO_DATA)
        return verdict;
    int change = changed(e, frame + start);
    Item *image = &e->image[e->mine_in];
    fill(image, ++e->number, now, verdict, frame, size);
    atomic_store(&e->heard, now);
    /* First the ring, then the image: who has seen the image finds every order before it in the ring. */
    if (change == 2)
        keep(e, image);
    fill(&e->last, image->number, now, verdict, frame, size);
    e->last_start = start;
    e->mine_in = atomic_exchange(&e->image_shared, e->mine_in | NEW) & ~NEW;
    if (change || ++e->unseen >= e->each) {
        e->unseen = 0;
        wake(e);
    }
    if (e->align)
        align(e, now);
    return verdict;
}

/* ---- input frames ---------------------------------------------------------------------------------------------- */

/* As Provider.poll: the size of the frame to send now, 0: none. */
static int provide(Engine *e, long long now, unsigned char *out)
{
    long long late = now - e->due;
    if (late < 0)
        return 0;
    long long skipped = late / e->cycle, silent = now - atomic_load(&e->alive);
    e->due += (skipped + 1) * e->cycle + e->move;
    e->move = 0;
    int counter = (int)((atomic_load(&e->sent_counter) + (skipped + 1) * e->step) & 0xFFFF);
    atomic_store(&e->sent_counter, counter);
    atomic_fetch_add(&e->counts[MISSED], skipped);
    if (silent > 2 * e->bound) {
        atomic_fetch_add(&e->counts[WITHHELD], 1);
        return 0;
    }
    if (atomic_load(&e->input_shared) & NEW)
        e->mine_out = atomic_exchange(&e->input_shared, e->mine_out) & ~NEW;
    memcpy(out, e->input[e->mine_out], e->frame_size);
    out[e->sent_at] = counter >> 8;
    out[e->sent_at + 1] = counter & 0xFF;
    if (silent > e->bound) {
        for (int i = 0; i < e->frame_size; i++)
            out[i] &= e->bad[i];
        atomic_fetch_add(&e->counts[INVALID], 1);
    }
    atomic_fetch_add(&e->counts[SENT], 1);
    atomic_fetch_add(&e->counts[OCTETS_OUT], e->frame_size);
    return e->frame_size;
}

/* ---- the thread ------------------------------------------------------------------------------------------------ */

static long long now_ns(void)
{
    struct timespec at;
    clock_gettime(CLOCK_BOOTTIME, &at);
    return (long long)at.tv_sec * SECOND + at.tv_nsec;
}

/* At usual scheduling: short turns, which Linux from 6.12 on begins sooner. Elsewhere it is refused, and nothing changes. */
static void ask_for_short_turns(void)
{
    struct {
        uint32_t size, policy;
        uint64_t flags;
        int32_t nice;
        uint32_t priority;
        uint64_t slice_ns, deadline, period;
    } wanted = {.size = sizeof wanted, .nice = getpriority(PRIO_PROCESS, 0), .slice_ns = 100000};
    if (sched_getscheduler(0) == SCHED_OTHER)
        (void)syscall(SYS_sched_setattr, 0, &wanted, 0);
}

static void *run(void *argument)
{
    Engine *e = argument;
    unsigned char frame[FRAME_MAX];
    struct pollfd ready[] = {{.fd = e->stop_fd, .events = POLLIN}, {.fd = e->socket_fd, .events = POLLIN}};
    int watched = 2;
    prctl(PR_SET_NAME, "pdgw-cyclic");
    prctl(PR_SET_TIMERSLACK, 1UL);
    ask_for_short_turns();
    while (!atomic_load(&e->stopping)) {
        int size = provide(e, now_ns(), frame);
        if (size) {
            watched = 2;
            if (send(e->socket_fd, frame, size, MSG_DONTWAIT) < 0)
                atomic_fetch_add(&e->counts[ERRORS], 1);
        }
        long long left = e->due - now_ns();
        left = left < 0 ? 0 : left;
        struct timespec wait = {left / SECOND, left % SECOND};
        if (ppoll(ready, watched, &wait, NULL) <= 0 || !(ready[1].revents && watched == 2))
            continue;
        ssize_t came = recv(e->socket_fd, frame, sizeof frame, MSG_DONTWAIT);
        if (came >= 0)
            offer(e, frame, (int)came, now_ns());
        else if (errno != EAGAIN && errno != EINTR) {
            atomic_fetch_add(&e->counts[ERRORS], 1);
            watched = 1; /* until the next input frame: an interface that is down must not keep a processor busy */
        }
    }
    return NULL;
}

static PyObject *start(Engine *e, PyObject *argument)
{
    int descriptor = (int)PyLong_AsLong(argument);
    if (descriptor < 0)
        return PyErr_Occurred() ? NULL : PyErr_Format(PyExc_ValueError, "no socket");
    if (e->running)
        return PyErr_Format(PyExc_RuntimeError, "the thread runs already");
    sigset_t all, before;
    struct sched_param scheduling;
    int policy;
    e->socket_fd = descriptor;
    sigfillset(&all);
    pthread_sigmask(SIG_BLOCK, &all, &before); /* signals are for Python's thread */
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, STACK); /* of 8 MiB with locked memory all would be used */
    int error = pthread_create(&e->thread, &attributes, run, e);
    pthread_attr_destroy(&attributes);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (error) {
        errno = error;
        return PyErr_SetFromErrno(PyExc_OSError);
    }
    e->running = 1;
    /* Above Python's thread, where that has a real-time priority and one more is granted. */
    if (!pthread_getschedparam(pthread_self(), &policy, &scheduling) && policy == SCHED_FIFO) {
        scheduling.sched_priority++;
        (void)pthread_setschedparam(e->thread, policy, &scheduling);
    }
    Py_RETURN_NONE;
}

static void join(Engine *e)
{
    if (!e->running)
        return;
    atomic_store(&e->stopping, 1);
    (void)!write(e->stop_fd, &(uint64_t){1}, sizeof(uint64_t));
    Py_BEGIN_ALLOW_THREADS
    pthread_join(e->thread, NULL);
    Py_END_ALLOW_THREADS
    e->running = 0;
}

static PyObject *stop(Engine *e, PyObject *Py_UNUSED(ignored))
{
    join(e);
    Py_RETURN_NONE;
}

/* ---- Python's side --------------------------------------------------------------------------------------------- */

static PyObject *given(Engine *e, const Item *item, int lost)
{
    int is_other = item && item->verdict == OTHER;
    if (item) { /* who takes it counts it */
        atomic_fetch_sub(&e->counts[item->verdict], 1);
        atomic_fetch_sub(&e->counts[OCTETS_IN], item->size);
        e->taken = is_other ? e->taken : item->number;
    }
    return Py_BuildValue("(y#LN)", item ? (const char *)item->data : "", (Py_ssize_t)(item ? item->size : 0),
                         is_other ? -1LL : (long long)atomic_load(&e->heard), PyBool_FromLong(lost));
}

/* The newest image, where Python has not had it. */
static const Item *newest(const Engine *e)
{
    return e->image[e->taking].number > e->taken ? &e->image[e->taking] : NULL;
}

static int waits(Engine *e)
{
    return atomic_load(&e->head_of_ring) != atomic_load(&e->tail_of_ring) || newest(e);
}

static PyObject *take(Engine *e, PyObject *argument)
{
    uint64_t times;
    PyObject *result = NULL;
    long long oldest = PyLong_AsLongLong(argument);
    if (PyErr_Occurred())
        return NULL;
    (void)!read(e->wake_fd, &times, sizeof times);
    atomic_store(&e->signalled, 0);
    /* The image before the ring: an order that the image is newer than is in the ring by now. */
    if (atomic_load(&e->image_shared) & NEW)
        e->taking = atomic_exchange(&e->image_shared, e->taking) & ~NEW;
    int lost = atomic_exchange(&e->lost, 0);
    unsigned tail = atomic_load(&e->tail_of_ring), head = atomic_load(&e->head_of_ring);
    for (unsigned at = tail; at != head && !lost; at++) {
        const Item *item = &e->ring[at % WAITING];
        lost = item->verdict != OTHER && item->number > e->taken && item->came < oldest;
    }
    if (lost)
        tail = head;
    for (; tail != head && !result; tail++) {
        const Item *item = &e->ring[tail % WAITING];
        if (item->verdict == OTHER || item->number > e->taken)
            result = given(e, item, 0);
    }
    atomic_store(&e->tail_of_ring, tail);
    if (!result && (lost || newest(e)))
        result = given(e, newest(e), lost);
    if (PyErr_Occurred())
        return NULL;
    if (waits(e))
        wake(e);
    return result ? result : Py_NewRef(Py_None);
}

static PyObject *publish(Engine *e, PyObject *args)
{
    Py_buffer frame;
    long long alive;
    if (!PyArg_ParseTuple(args, "y*L", &frame, &alive))
        return NULL;
    int fits = frame.len == e->frame_size;
    if (fits) {
        memcpy(e->input[e->filling], frame.buf, frame.len);
        e->filling = atomic_exchange(&e->input_shared, e->filling | NEW) & ~NEW;
        atomic_store(&e->alive, alive);
    }
    PyBuffer_Release(&frame);
    return fits ? Py_NewRef(Py_None) : PyErr_Format(PyExc_ValueError, "a frame of another size");
}

static PyObject *counts(Engine *e, PyObject *Py_UNUSED(ignored))
{
    PyObject *list = PyTuple_New(COUNTS);
    for (int i = 0; list && i < COUNTS; i++)
        PyTuple_SetItem(list, i, PyLong_FromLongLong(atomic_exchange(&e->counts[i], 0)));
    return list;
}

static PyObject *offer_one(Engine *e, PyObject *args)
{
    Py_buffer frame;
    long long now;
    if (e->running)
        return PyErr_Format(PyExc_RuntimeError, "the thread receives");
    if (!PyArg_ParseTuple(args, "y*L", &frame, &now))
        return NULL;
    int size = frame.len > FRAME_MAX ? FRAME_MAX : (int)frame.len;
    int verdict = offer(e, frame.buf, size, now);
    PyBuffer_Release(&frame);
    return PyLong_FromLong(verdict);
}

static PyObject *provide_one(Engine *e, PyObject *argument)
{
    unsigned char frame[FRAME_MAX];
    long long now = PyLong_AsLongLong(argument);
    if (PyErr_Occurred())
        return NULL;
    if (e->running)
        return PyErr_Format(PyExc_RuntimeError, "the thread sends");
    int size = provide(e, now, frame);
    return size ? PyBytes_FromStringAndSize((const char *)frame, size) : Py_NewRef(Py_None);
}

static PyObject *fileno_of(Engine *e, PyObject *Py_UNUSED(ignored)) { return PyLong_FromLong(e->wake_fd); }
static PyObject *due_of(Engine *e, void *Py_UNUSED(closure)) { return PyLong_FromLongLong(e->due); }
static PyObject *more_of(Engine *e, void *Py_UNUSED(closure)) { return PyBool_FromLong(waits(e)); }
static PyObject *signalled_of(Engine *e, void *Py_UNUSED(closure)) { return PyBool_FromLong(atomic_load(&e->signalled)); }
static PyObject *counter_of(Engine *e, void *Py_UNUSED(closure)) { return PyLong_FromLong(atomic_load(&e->sent_counter)); }

static void dealloc(Engine *e)
{
    PyTypeObject *type = Py_TYPE((PyObject *)e);
    join(e);
    if (e->wake_fd > 0)
        close(e->wake_fd);
    if (e->stop_fd > 0)
        close(e->stop_fd);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(e);
    Py_DECREF(type);
}

static PyObject *new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"head", "tag", "tag_size", "counter_at", "status_at", "transfer_at", "order_mask", "newest",
                            "valid", "ignore", "primary", "run", "counter", "wake_each", "frame", "bad_mask", "sent_at",
                            "sent_counter", "step", "cycle_ns", "align", "due", "bound_ns", "now", NULL};
    Py_buffer head, tag, mask, frame, bad;
    int sent_counter;
    long long now;
    Engine *e = ((Engine * (*)(PyTypeObject *, Py_ssize_t)) PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (!e)
        return NULL;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "$y*y*iiiiy*iiiiiiiy*y*iiiLpLLL", names, &head, &tag, &e->tag_size,
                                     &e->counter_at, &e->status_at, &e->transfer_at, &mask, &e->newest, &e->valid,
                                     &e->ignore, &e->primary, &e->run, &e->counter, &e->each, &frame, &bad, &e->sent_at,
                                     &sent_counter, &e->step, &e->cycle, &e->align, &e->due, &e->bound, &now)) {
        Py_DECREF(e);
        return NULL;
    }
    e->head_size = (int)head.len;
    e->tag_at = e->head_size - 4; /* behind both addresses; EtherType and FrameID follow */
    e->size = (int)mask.len;
    e->frame_size = (int)frame.len;
    int fits = head.len > 4 && head.len <= FRAME_MAX && tag.len == 2 && mask.len <= FRAME_MAX && bad.len == frame.len &&
               frame.len <= FRAME_MAX && e->counter_at >= 0 && e->counter_at + 1 < mask.len && e->status_at >= 0 &&
               e->status_at < mask.len && e->transfer_at >= 0 && e->transfer_at < mask.len && e->sent_at >= 0 &&
               e->sent_at + 1 < frame.len && e->tag_size >= 0 && e->cycle > 0 && e->bound > 0;
    if (fits) {
        memcpy(e->head, head.buf, head.len);
        memcpy(e->tag, tag.buf, 2);
        memcpy(e->mask, mask.buf, mask.len);
        memcpy(e->bad, bad.buf, bad.len);
        memcpy(e->input[0], frame.buf, frame.len);
        e->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
        e->stop_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
        e->mine_in = 0, e->taking = 1;
        atomic_store(&e->image_shared, 2);
        e->mine_out = 0, e->filling = 1;
        atomic_store(&e->input_shared, 2);
        atomic_store(&e->heard, now);
        atomic_store(&e->alive, now);
        atomic_store(&e->sent_counter, sent_counter);
    }
    Py_buffer *all[] = {&head, &tag, &mask, &frame, &bad};
    for (int i = 0; i < 5; i++)
        PyBuffer_Release(all[i]);
    if (fits && e->wake_fd >= 0 && e->stop_fd >= 0)
        return (PyObject *)e;
    fits ? PyErr_SetFromErrno(PyExc_OSError) : PyErr_Format(PyExc_ValueError, "a size that does not fit");
    Py_DECREF(e);
    return NULL;
}

static PyMethodDef methods[] = {
    {"start", (PyCFunction)start, METH_O, "Receive from and send to this socket in a thread; OSError where there is none."},
    {"stop", (PyCFunction)stop, METH_NOARGS, "End the thread."},
    {"fileno", (PyCFunction)fileno_of, METH_NOARGS, "Readable when something is to be taken."},
    {"take", (PyCFunction)take, METH_O, "The next frame, when the newest one came, whether orders before it are lost: too many or too old."},
    {"publish", (PyCFunction)publish, METH_VARARGS, "The input frame from now on, and when the drive objects were stepped."},
    {"counts", (PyCFunction)counts, METH_NOARGS, "What was counted since the last call."},
    {"offer", (PyCFunction)offer_one, METH_VARARGS, "A received frame; its verdict. Without the thread."},
    {"provide", (PyCFunction)provide_one, METH_O, "The input frame when it is due. Without the thread."},
    {NULL, NULL, 0, NULL},
};
static PyGetSetDef getters[] = {
    {"due", (getter)due_of, NULL, "When the next input frame is due.", NULL},
    {"more", (getter)more_of, NULL, "Something waits behind what was taken.", NULL},
    {"signalled", (getter)signalled_of, NULL, "The descriptor can be read.", NULL},
    {"counter", (getter)counter_of, NULL, "CycleCounter of the last input frame.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};
static PyType_Slot slots[] = {
    {Py_tp_new, new}, {Py_tp_dealloc, dealloc}, {Py_tp_methods, methods}, {Py_tp_getset, getters}, {0, NULL},
};
static PyType_Spec spec = {"pdgw.gateway.links.profinet.engine.Engine", sizeof(Engine), 0, Py_TPFLAGS_DEFAULT, slots};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "engine", NULL, -1, NULL, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_engine(void)
{
    PyObject *made = PyModule_Create(&module), *type = PyType_FromSpec(&spec);
    if (made && type && !PyModule_AddObjectRef(made, "Engine", type)) {
        Py_DECREF(type);
        return made;
    }
    Py_XDECREF(type);
    Py_XDECREF(made);
    return NULL;
}
