/* A program under test and its output. */
#ifndef TROCAR_TESTS_SLICER_PROGRAM_H
#define TROCAR_TESTS_SLICER_PROGRAM_H

#include <fcntl.h>
#include <fstream>
#include <signal.h>
#include <sstream>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include "expect.h"

class Program {
public:
    Program(const std::string &folder, std::vector<std::string> arguments) : out(folder + "/out"), errors(folder + "/errors") {
        for (const std::string &path : {out, errors}) std::ofstream(path).flush();
        pid = fork();
        if (pid != 0) return;
        dup2(open(out.c_str(), O_WRONLY | O_TRUNC), STDOUT_FILENO);
        dup2(open(errors.c_str(), O_WRONLY | O_TRUNC), STDERR_FILENO);
        std::vector<char *> texts;
        for (std::string &a : arguments) texts.push_back(&a[0]);
        texts.push_back(nullptr);
        execv(texts[0], texts.data());
        _exit(127);
    }
    ~Program() {
        if (pid > 0) stop(SIGTERM);
    }
    bool ready() { return soon([this] { return has_ended() || printed("ready\n"); }, 60) && !has_ended(); }
    bool has_ended() {
        if (pid > 0 && waitpid(pid, &status, WNOHANG) == pid) pid = 0;
        return pid <= 0;
    }
    int stop(int signal) { /* returns the exit status, or -signal */
        if (!has_ended()) {
            kill(pid, signal);
            waitpid(pid, &status, 0);
            pid = 0;
        }
        if (said("Sanitizer")) std::fputs(errors_text().c_str(), stderr); /* for the witness */
        return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
    }
    int exit_status() {
        soon([this] { return has_ended(); }, 60);
        return stop(SIGKILL);
    }
    bool printed(const std::string &text) const { return read(out).find(text) != std::string::npos; }
    bool said(const std::string &text) const { return read(errors).find(text) != std::string::npos; }
    std::string errors_text() const { return read(errors); }
    int port() const {
        std::istringstream text(read(out));
        std::string word;
        int port = 0;
        text >> word >> port;
        return port;
    }
    long memory() const { /* resident, bytes */
        std::ifstream file("/proc/" + std::to_string(pid) + "/statm");
        long size = 0, resident = 0;
        file >> size >> resident;
        return resident * sysconf(_SC_PAGESIZE);
    }

private:
    static std::string read(const std::string &path) {
        std::ifstream file(path);
        std::ostringstream text;
        text << file.rdbuf();
        return text.str();
    }
    std::string out, errors;
    pid_t pid = 0;
    int status = 0;
};

#endif
