/* Makes text from the network safe to show on a terminal, in a log or on a page. */
#ifndef TROCAR_PRINTABLE_H
#define TROCAR_PRINTABLE_H

/* Replaces with '?' every byte that is not part of a printable UTF-8 character. That includes control characters such as escape, bell and line feed,
   invalid bytes, and characters that change the text direction. */
void make_printable(char *text);

#endif
