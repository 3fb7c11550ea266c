/* What the system's linux/input.h says of the numbers and layouts that manyhands' driver of event devices writes down. */
#include <linux/input.h>
#include <stddef.h>
#include <stdio.h>

#define SAY(name, value) printf(name " %lld\n", (long long)(value))

int main(void) {
    SAY("event", sizeof(struct input_event));
    SAY("effect", sizeof(struct ff_effect));
    SAY("absinfo", sizeof(struct input_absinfo));
    SAY("id", offsetof(struct ff_effect, id));
    SAY("direction", offsetof(struct ff_effect, direction));
    SAY("length", offsetof(struct ff_effect, replay.length));
    SAY("level", offsetof(struct ff_effect, u.constant.level));
    SAY("sff", EVIOCSFF);
    SAY("rmff", EVIOCRMFF);
    SAY("grab", EVIOCGRAB);
    SAY("clock", EVIOCSCLOCKID);
    SAY("types", EVIOCGBIT(0, 96));
    SAY("forces", EVIOCGBIT(EV_FF, 96));
    SAY("get", EVIOCGABS(ABS_WHEEL));
    SAY("set", EVIOCSABS(ABS_WHEEL));
    SAY("constant", FF_CONSTANT);
    SAY("gain", FF_GAIN);
    SAY("autocenter", FF_AUTOCENTER);
    SAY("rumble", FF_RUMBLE);
    SAY("dropped", SYN_DROPPED);
    return 0;
}
