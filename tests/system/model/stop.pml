/* Stop is final: daemon, one device node and the network between them.

   Whatever is sent is a process of its own until it has arrived, so that frames arrive in any order, however late.
   A process that never takes its next step stands for what is lost, or does not happen. Checked by test_stop_model.py
   in all interleavings of two motions, Stop, acknowledgements, one danger event, one hold by the node itself and one
   crash of either side. docs/supervision.md says what the model covers and what not.

   -D NO_EPOCH, NO_SESSIONS, NO_RELEASE_CHECK, NO_PENDING, NO_LOCK, STAMPED_LATE leave out one rule each, and have a
   counterexample. -D REACHES looks for a motion that begins after a Stop was confirmed and acknowledged: there is one.

   Lines that begin with "gate" are calls of pcmrs/devices/gate.py with their results, for the replay. -D STEPS adds what
   the replay on the dispatcher needs: a line "step" with what happens, and one "state" with what is true after it.
   -D DELAY=n is for random traces. */

#define STOPS 3                    /* by an operator, by a danger event, by a beat that shows a latch */
#define DONE end: false            /* a process that stays costs fewer states than one that is removed */

/* The node's gate. Sessions are random in the code; here they count. */
byte node = 1, epoch = 0, present = 0, last = 0;
bool closed = true;
byte moving = 0;                   /* the motion that moves the arm; 0: it stands */

/* The daemon. What a crash leaves is what the journal has: latched, begun, newest. */
byte daemon = 1, number = 0;
bool connected = false, latched = false, begun = false;
byte newest = 0;                   /* number of the newest Stop */
byte sent_by[4];                   /* which daemon has sent the hold of a Stop that is not yet on its way */
bool hold_pending = false, event_pending = false;
byte known_node = 0, known_epoch = 0;
bool releasing = false;            /* a connection or an acknowledgement is under way */
byte running = 0;                  /* the motion that the dispatcher runs */
bool ending = false;               /* a motion was stopped, and waits for the hold of its Stop */
bool committing = false, ready = true, at_body = false;

/* Of alike processes one begins after the other: which of them is first makes no difference. */
byte connects = 0, acknowledgements = 0, motions = 0;

/* What is promised. */
bool final = false;                /* a Stop is confirmed, and no acknowledgement was accepted since */
byte confirmed = 0;                /* Stops that were confirmed */

#ifdef NO_EPOCH
#define EPOCH_FITS(e) true
#else
#define EPOCH_FITS(e) (e == epoch)
#endif
#ifdef NO_SESSIONS
#define SESSIONS_FIT(d, n) true
#define NODE_FITS(n) true
#else
#define SESSIONS_FIT(d, n) (d == present && n == node)
#define NODE_FITS(n) (n == node)
#endif
#ifdef NO_RELEASE_CHECK
#define RELEASE_FITS(n, e) true
#else
#define RELEASE_FITS(n, e) (NODE_FITS(n) && EPOCH_FITS(e))
#endif

#ifdef NO_PENDING
#define NOTHING_PENDING true
#else
#define NOTHING_PENDING (!event_pending)
#endif

#define CAN_MOVE (connected && !latched && running == 0 && ready)
#define CAN_ACKNOWLEDGE \
    (connected && latched && !releasing && running == 0 && !hold_pending && NOTHING_PENDING)

#ifdef STEPS
#define STEP(line) line
#define STATE printf("state %d %d %d %d %d %d %d %d %d\n", connected, latched, hold_pending, event_pending, ready, \
    at_body, moving, CAN_MOVE, CAN_ACKNOWLEDGE)
#else
#define STEP(line) skip
#define STATE skip
#endif

/* In random traces what disturbs waits for so many turns: otherwise hardly any motion begins before it. */
#ifdef DELAY
#define AFTER_A_WHILE byte turns; do :: turns < DELAY -> turns++ :: else -> break od;
#else
#define AFTER_A_WHILE
#endif

/* A hold as the gate takes it: at once when it is received. */
inline close_gate() {
    epoch++;
    closed = true;
    moving = 0;
    printf("gate hold %d %d\n", node, epoch)
}

/* A report of the node reaches the daemon; one that is older than the last is not taken. */
inline know(reported_node, reported_epoch) {
    if
    :: reported_node > known_node || (reported_node == known_node && reported_epoch > known_epoch) ->
        known_node = reported_node;
        known_epoch = reported_epoch
    :: else
    fi
}

/* Latch, number and holds are one step of the daemon's loop. Who stops while a hold is under way waits for that one. */
inline stop() {
    newest++;
    latched = true;
    releasing = false;
    if
    :: !hold_pending -> hold_pending = true; sent_by[newest] = daemon
    :: else
    fi;
    if
    :: running != 0 && !committing -> running = 0; ending = true; at_body = false
    :: else
    fi
}

/* The hold of a Stop, and its reply. */
proctype Hold(byte which) {
    byte d, n, e;
    atomic { sent_by[which] != 0 -> d = sent_by[which]; sent_by[which] = 0 }
    atomic { STEP(printf("step hold %d\n", d)); close_gate(); n = node; e = epoch; STATE }
    atomic {                                                  /* the arm stands; the reply arrives */
        STEP(printf("step held %d\n", d));
        if
        :: d == daemon ->
            know(n, e);
            hold_pending = false;
            ending = false;
            final = true;
            confirmed++
        :: else
        fi;
        d = 0; n = 0; e = 0;
        STATE
    }
    DONE
}

/* A hold that latches nothing, for an arm that does not stand is not released; then the release; and their replies. */
inline release() {
    atomic {
        STEP(printf("step end %d %d\n", d, which));
        epoch++;
        moving = 0;
        n = node; e = epoch;
        printf("gate end %d %d\n", node, epoch);
        STATE
    }
    if
    :: atomic { d == daemon && which == newest ->
            STEP(printf("step ended %d %d\n", d, which));
            know(n, e);
            n = known_node; e = known_epoch;
            STATE }
    :: atomic { else -> goto over }                           /* stopped, or of a daemon that was killed */
    fi;
    atomic {
        STEP(printf("step release %d %d\n", d, which));
        taken = RELEASE_FITS(n, e);
        printf("gate release %d %d %d -> %d\n", d, n, e, taken);
        if
        :: taken ->
            assert(!final);        /* nothing opens the gate after a confirmed Stop but its acknowledgement */
            closed = false;
            if
            :: present != d -> present = d; last = 0
            :: else
            fi
        :: else
        fi;
        STATE
    }
    atomic {
        STEP(printf("step released %d %d\n", d, which));
        if
        :: d == daemon && which == newest ->
            releasing = false;
            if
            :: taken && NOTHING_PENDING -> latched = false; begun = false; connected = true
            :: else
            fi
        :: else
        fi;
        STATE
    }
over:
    atomic { d = 0; n = 0; e = 0; which = 0; taken = 0 }
}

proctype Connect(byte turn) {
    byte d, n, e, which;
    bool taken;
    if
    :: atomic { turn == connects && !connected && !releasing && latched ->
            STEP(printf("step connect %d %d\n", daemon, newest));
            connects++;
            know(node, epoch);
            connected = true;
            STATE }
    :: atomic { turn == connects && !connected && !releasing && !latched ->
            STEP(printf("step connect %d %d\n", daemon, newest));
            connects++;
            know(node, epoch);
            releasing = true;
            d = daemon; which = newest;
            STATE }
        release()
    fi;
    DONE
}

proctype Acknowledge(byte turn) {
    byte d, n, e, which;
    bool taken;
    atomic {
        turn == acknowledgements && CAN_ACKNOWLEDGE ->
        STEP(printf("step acknowledge %d %d\n", daemon, newest));
        acknowledgements++;
        final = false;
        releasing = true;
        d = daemon; which = newest;
        STATE
    }
    release();
    DONE
}

/* A motion from its admission to its commit; its request is on its way from the second step on. */
proctype Motion(byte m) {
    byte d, n, e, count, stops;
    bool taken;
    atomic {
        m == motions + 1 && CAN_MOVE ->
        STEP(printf("step motion %d\n", m));
        motions++;
        assert(!event_pending);
        running = m;
        d = daemon;
        STATE
    }
    if
    :: atomic {                                               /* the intent is on the disk */
        d == daemon && running == m ->
        STEP(printf("step request %d\n", m));
        begun = true;
        number++;
        n = known_node; e = known_epoch; count = number; stops = confirmed;
        STATE
    }
        atomic {                                              /* the request arrives */
            STEP(printf("step arrive %d\n", m));
#ifdef STAMPED_LATE
            n = known_node;
            e = known_epoch;
#endif
            taken = !closed && SESSIONS_FIT(d, n) && EPOCH_FITS(e) && count > last;
            printf("gate admit %d %d %d %d -> %d\n", d, n, e, count, taken);
            if
            :: taken ->
                last = count;
                assert(!final);
                assert(stops == confirmed);                   /* no Stop was confirmed since it was asked for */
                assert(d == daemon || present != daemon);     /* nor is it one of a daemon that was replaced */
#ifdef REACHES
                assert(confirmed == 0);
#endif
                moving = m
            :: else
            fi;
            n = 0; e = 0; count = 0; stops = 0;
            STATE
        }
        if
        :: atomic {                                           /* it is where it should be; the reply arrives */
                taken && moving == m ->
                STEP(printf("step done %d\n", m));
                moving = 0;
                if
                :: d == daemon && running == m && ready -> committing = true
                :: else
                fi;
                STATE
            }
            atomic {                                          /* the row is on the disk */
                STEP(printf("step committed %d\n", m));
                if
                :: d == daemon && running == m && committing ->
                    assert(ready);                            /* the tool is at the body only with a registration */
                    committing = false;
                    running = 0;
                    begun = false;
                    at_body = true
                :: else
                fi;
                STATE
            }
        :: atomic {                                           /* refused or held: the operation has failed */
                !taken || moving != m ->
                STEP(printf("step failed %d\n", m));
                if
                :: d == daemon && running == m -> running = 0; begun = false; at_body = false
                :: else
                fi;
                STATE
            }
        fi
    :: d != daemon || running != m                            /* stopped before it was asked for */
    fi;
    atomic { d = 0; taken = false }
    DONE
}

proctype Stopper() {
    AFTER_A_WHILE
    atomic { newest < STOPS -> STEP(printf("step stop\n")); stop(); STATE }
    DONE
}

proctype Event() {
    AFTER_A_WHILE
    atomic { newest < STOPS -> STEP(printf("step event\n")); stop(); event_pending = true; STATE }
    atomic {
#ifdef NO_LOCK
        event_pending ->
#else
        event_pending && !committing && !ending ->            /* what it changes is locked until then */
#endif
        STEP(printf("step decided\n"));
        ready = false;
        at_body = false;
        event_pending = false;
        STATE
    }
    DONE
}

proctype Beats() {
    do
    :: atomic { connected && !hold_pending && (latched || !closed || newest < STOPS) &&
            (known_node != node || known_epoch != epoch || (!latched && closed)) ->
            STEP(printf("step beat\n"));
            know(node, epoch);
            if
            :: !latched && closed -> stop()                   /* it has held by itself, or has restarted alone */
            :: else
            fi;
            STATE }
    od
}

proctype Deadman() {
    AFTER_A_WHILE
    atomic { STEP(printf("step deadman\n")); close_gate(); STATE }
    DONE
}

proctype Crash() {
    AFTER_A_WHILE
    if
    :: atomic {                                               /* the node restarts alone */
        STEP(printf("step restart\n"));
        node++;
        epoch = 0;
        present = 0;
        last = 0;
        closed = true;
        moving = 0;
        printf("gate restart %d\n", node);
        STATE
    }
    :: atomic {                                               /* the daemon restarts alone */
        STEP(printf("step crash\n"));
        daemon++;
        number = 0;
        connected = false;
        latched = latched || begun;
        begun = false;
        running = 0;
        ending = false;
        committing = false;
        releasing = false;
        hold_pending = false;
        event_pending = false;
        at_body = false;
        known_node = 0;
        known_epoch = 0;
        ready = true;
        STATE
    }
    fi;
    DONE
}

init {
    atomic {
        run Beats();
        run Connect(0); run Connect(1);
        run Motion(1); run Motion(2);
        run Hold(1); run Hold(2); run Hold(3);
        run Acknowledge(0);
#ifdef TWO_ACKNOWLEDGEMENTS
        run Acknowledge(1);
#endif
#ifdef NODE_HOLDS
        run Deadman();
#endif
#ifndef NO_CRASH
        run Crash();
#endif
        run Stopper(); run Event()
    }
}
