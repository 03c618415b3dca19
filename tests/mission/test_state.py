from companion.mission.phases import Phase, Reason, Trigger

# Design section 7, written down a second time.
ANYTIME = {"done", "faulted"}
AGAIN = {"preparing"}
DOWN = {"landing", "handing over"}
ARROWS = {
    "waiting": {"preparing"},
    "preparing": {"ready", "arming", "holding", "flying", "landing", "shadow"} | DOWN | AGAIN,
    "ready": {"arming"} | AGAIN,
    "arming": {"taking off", "holding"} | AGAIN,
    "taking off": {"flying", "holding"} | DOWN | AGAIN,
    "flying": {"arrived", "holding"} | DOWN | AGAIN,
    "holding": {"flying", "returning"} | DOWN | AGAIN,
    "arrived": {"flying", "holding", "returning"} | DOWN | AGAIN,
    "returning": {"flying", "holding"} | DOWN | AGAIN,
    "landing": {"holding", "handing over"} | AGAIN,
    "handing over": {"landing"} | AGAIN,
    "shadow": AGAIN,
}
ARROWS = {phase: after | ANYTIME for phase, after in ARROWS.items()}


def test_the_table_has_the_arrows_of_the_design_and_no_others() -> None:
    arrows: dict[str, set[str]] = {}
    for trigger in Trigger:
        for phase in trigger.origins:
            arrows.setdefault(phase.value, set()).add(trigger.after.value)
    assert arrows == ARROWS


def test_a_person_can_stop_a_mission_in_every_phase_that_it_can_be_in() -> None:
    assert {Phase(phase) for phase in ARROWS} == set(Trigger.STOP.origins)
    assert Trigger.STOP.after is Phase.DONE


def test_every_reason_says_what_happened_and_what_to_do_in_a_text_of_50_bytes() -> None:
    texts = [reason.text for reason in Reason]
    assert len(set(texts)) == len(texts)
    for reason in Reason:
        assert len(reason.text.encode()) + len("hold: ") <= 60
        assert reason.remedy.endswith(".")
        assert reason.text == reason.text.strip().rstrip(".")
