"""Tables of mistakes as text: each input, and below it the message that answers it."""


def cases(text: str) -> list[tuple[str, str]]:
    """Pairs of an input and a message.

    A message begins with `=> `, and goes on in lines that are indented by three spaces. The lines before it,
    from the last message on, are the input.
    """
    found: list[tuple[list[str], list[str]]] = []
    given: list[str] = []
    for line in text.strip("\n").splitlines():
        if line.startswith("=> "):
            found.append((given, [line[3:]]))
            given = []
        elif line.startswith("   ") and not given:
            found[-1][1].append(line.strip())
        else:
            given.append(line)
    assert not given, given
    return [("\n".join(lines), " ".join(message)) for lines, message in found]
