/* trocar-haply: connects a Haply Inverse3 to trocar-server. */
#include <stdlib.h>

#include "options.h"

const char *argp_program_version = "trocar-haply " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

static const struct argp parser = {NULL, NULL, NULL, "Connects a Haply Inverse3 to trocar-server.", NULL, NULL, NULL};

int main(int count, char **arguments) {
    argp_parse(&parser, count, arguments, 0, NULL, NULL);
    return EXIT_SUCCESS;
}
