/* Lets one thread wake another through an eventfd. */
#ifndef TROCAR_EVENTFD_SIGNAL_H
#define TROCAR_EVENTFD_SIGNAL_H

void eventfd_signal(int eventfd); /* RT */
void eventfd_wait(int eventfd);   /* blocks until signalled; returns at once if a signal is pending */

#endif
