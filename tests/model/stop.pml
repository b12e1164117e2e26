/* Stop is final: daemon, one device node and the network between them.

   Whatever is sent is a process of its own until it has arrived, so that frames arrive in any order, however late.
   A process that never takes its next step stands for what is lost, or does not happen. Checked by test_stop_model.py
   in all interleavings of two motions, Stop, acknowledgements, one danger event, one hold by the node itself and one
   crash of either side. docs/supervision.md says what the model covers and what not.

   -D NO_EPOCH, NO_SESSIONS, NO_RELEASE_CHECK, NO_PENDING, NO_LOCK, STAMPED_LATE leave out one rule each, and have a
   counterexample. -D REACHES looks for a motion that begins after a Stop was confirmed and acknowledged: there is one.

   Lines that begin with "gate" are calls of pcmrs/devices/gate.py with their results, for the replay. */

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
byte known_node = 0, known_epoch = 0, released_node = 0, released_epoch = 0;
byte running = 0;                  /* the motion that the dispatcher runs */
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

/* A hold as the gate takes it: at once when it is received. */
inline close_gate() {
    epoch++;
    closed = true;
    moving = 0;
    printf("gate hold %d %d\n", node, epoch)
}

/* Latch, number and holds are one step of the daemon's loop. */
inline stop() {
    newest++;
    latched = true;
    hold_pending = true;
    sent_by[newest] = daemon;
    if
    :: !committing -> running = 0
    :: else
    fi
}

/* The hold of one Stop, its reply, and the limit after which it is pending no more. */
proctype Hold(byte which) {
    byte d, n, e;
    atomic { sent_by[which] != 0 -> d = sent_by[which]; sent_by[which] = 0 }
#ifdef SILENT
    if
    :: atomic { d == daemon && which == newest && hold_pending -> hold_pending = false }
    :: true
    fi;
#endif
    atomic { close_gate(); n = node; e = epoch }
    atomic {                                                  /* the arm stands; the reply arrives */
        if
        :: d == daemon ->
            known_node = n;
            known_epoch = e;
            if
            :: which == newest && hold_pending -> hold_pending = false; final = true; confirmed++
            :: else
            fi
        :: else
        fi;
        d = 0; n = 0; e = 0
    }
    DONE
}

/* A release on its way, and its reply. */
inline release() {
    atomic {
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
        fi
    }
    atomic {
        if
        :: d == daemon && taken && which == newest && NOTHING_PENDING ->
            latched = false;
            begun = false;
            connected = true;
            released_node = n;
            released_epoch = e
        :: else
        fi;
        d = 0; n = 0; e = 0; which = 0; taken = 0
    }
}

proctype Connect(byte turn) {
    byte d, n, e, which;
    bool taken;
    if
    :: atomic { turn == connects && !connected && latched -> connects++; connected = true }
    :: atomic { turn == connects && !connected && !latched ->
            connects++;
            d = daemon; n = node; e = epoch; which = newest;
            known_node = n; known_epoch = e }
        release()
    fi;
    DONE
}

proctype Acknowledge(byte turn) {
    byte d, n, e, which;
    bool taken;
    atomic {
        turn == acknowledgements && connected && latched && !hold_pending && NOTHING_PENDING ->
        acknowledgements++;
        final = false;
        d = daemon; n = known_node; e = known_epoch; which = newest
    }
    release();
    DONE
}

/* A motion from its admission to its commit; its request is on its way from the second step on. */
proctype Motion(byte m) {
    byte d, n, e, count, stops;
    bool taken;
    atomic {
        m == motions + 1 && connected && !latched && running == 0 && ready ->
        motions++;
        assert(!event_pending);
        running = m;
        begun = true;
        d = daemon
    }
    if
    :: atomic {                                               /* the intent is on the disk */
        d == daemon && running == m ->
        number++;
        n = known_node; e = known_epoch; count = number; stops = confirmed
    }
        atomic {                                              /* the request arrives */
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
            n = 0; e = 0; count = 0; stops = 0
        }
        if
        :: atomic {                                           /* it is where it should be; the reply arrives */
                taken && moving == m ->
                moving = 0;
                if
                :: d == daemon && running == m && ready -> committing = true
                :: else
                fi
            }
            atomic {                                          /* the row is on the disk */
                if
                :: d == daemon && running == m && committing ->
                    assert(ready);                            /* the tool is at the body only with a registration */
                    committing = false;
                    running = 0;
                    begun = false;
                    at_body = true
                :: else
                fi
            }
        :: atomic {                                           /* refused or held: the operation has failed */
                !taken || moving != m ->
                if
                :: d == daemon && running == m -> running = 0; begun = false
                :: else
                fi
            }
        fi
    :: d != daemon || running != m                            /* stopped before it was asked for */
    fi;
    atomic { d = 0; taken = false }
    DONE
}

proctype Stopper() {
    atomic { newest < STOPS -> stop() }
    DONE
}

proctype Event() {
    atomic { newest < STOPS -> stop(); event_pending = true }
    atomic {
#ifdef NO_LOCK
        event_pending ->
#else
        event_pending && !committing ->
#endif
        ready = false;
        at_body = false;
        event_pending = false
    }
    DONE
}

proctype Beats() {
    do
    :: atomic { connected && !hold_pending && (known_node != node || known_epoch != epoch) ->
            known_node = node; known_epoch = epoch }
    :: atomic { connected && !latched && closed && newest < STOPS &&
            (node != released_node || epoch != released_epoch) -> stop() }
    od
}

proctype Deadman() {
    atomic { close_gate() }
    DONE
}

proctype Crash() {
    if
    :: atomic {                                               /* the node restarts alone */
        node++;
        epoch = 0;
        present = 0;
        last = 0;
        closed = true;
        moving = 0;
        printf("gate restart %d\n", node)
    }
    :: atomic {                                               /* the daemon restarts alone */
        daemon++;
        number = 0;
        connected = false;
        latched = latched || begun;
        begun = false;
        running = 0;
        committing = false;
        hold_pending = false;
        event_pending = false;
        at_body = false;
        known_node = 0;
        known_epoch = 0;
        released_node = 0;
        released_epoch = 0;
        ready = true
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
