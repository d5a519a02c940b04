/* Text that came from the network, before it goes to a terminal, a log or a page. */
#ifndef TROCAR_PRINTABLE_H
#define TROCAR_PRINTABLE_H

/* Replaces by '?' each byte that is not part of a printable character in UTF-8: control characters, such as escape, bell and line feed, bytes that
   form no character, and characters that change the order in which text is read. */
void make_printable(char *text);

#endif
