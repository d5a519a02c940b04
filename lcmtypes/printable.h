/* Makes text from the network safe for a terminal, a log or a page. */
#ifndef TROCAR_PRINTABLE_H
#define TROCAR_PRINTABLE_H

/* Replaces each byte that is not part of a printable UTF-8 character by '?': control characters such as escape, bell and line feed, invalid bytes,
   and characters that change the direction of text. */
void make_printable(char *text);

#endif
